"""Whether rewards of any size and style train: steps until the first full lap.

    python scripts/bench rewards [--styles NAME ...] [--scales FACTOR ...] [--seeds 1 2 3]
        [--results FILE] [--cap 60000] [--threads 1] [--precision fp32] [--json]

Ten reward functions in the styles that racers publish (reward_styles/), the shipped one
times each of --scales, and defaults/rewards/speed as it is and times 0.1. Everything else is as
shipped. Each training drives and learns in this process as the workers do; every checkpoint drives
five evaluation laps, and the training ends with the first one that is completed, or at --cap steps.
Steps are counted and no time, so other programs make it slower and change nothing.

With --results each finished training is appended to a file, a JSON object a line, and one that
stands there already is not repeated: the benchmark goes on where it was stopped. `--styles` without
a name leaves the styles out, and `--scales` without a factor the scales.

With --json the last line of stdout is one object with `medians` by name and the bars:

    styles_that_lap     styles of which at least two of three seeds reached a lap
    scales_ratio        greatest over least median of the shipped reward's scales; aim 1.5
    missed              what missed a bar, or was left out and why
"""

import argparse
import importlib.util
import json
import os
import statistics
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from learn_runs import SHIPPED_FILES, MemoryTraining, Work

from drcli.exchange.job import PROCESS_TUNING
from drcli.learn.compute import flush_denormals

STYLES = Path(__file__).resolve().parent / "reward_styles"

NEEDS = {"numpy_gaussian": "numpy", "shapely_corridor": "shapely"}
"""What a style imports."""

SCALES = (0.001, 0.01, 1.0, 100.0, 10_000.0)
SPEED_SCALES = (0.1, 1.0)
TRIALS = 5
LAPPING_SHARE = 2 / 3
SCALES_RATIO = 1.5


@dataclass(frozen=True)
class Case:
    """A training to be measured.

    Attributes:
        style: A file of `STYLES`, "shipped" or "speed".
        factor: What its rewards are multiplied by.
        seed: Of the training.
    """

    style: str
    factor: float
    seed: int

    @property
    def name(self) -> str:
        """Style and factor."""
        return self.style if self.factor == 1.0 else f"{self.style} x {self.factor:g}"


@dataclass(frozen=True)
class Result:
    """How it went.

    Attributes:
        case: What was trained.
        steps: Steps learned from by the first checkpoint that completed an evaluation lap; None
            where there was none.
    """

    case: Case
    steps: int | None


def main() -> int:
    """Train, and report."""
    every = sorted(path.stem for path in STYLES.glob("*.py"))
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--styles", nargs="*", default=every, choices=every, metavar="NAME")
    parser.add_argument("--scales", nargs="*", type=float, default=SCALES, metavar="FACTOR")
    parser.add_argument("--speed", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--results", type=Path, help="file to append to and to go on from")
    parser.add_argument("--cap", type=int, default=60_000, help="most steps of a training")
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--precision", choices=["auto", "fp32", "bf16"], default="fp32")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if any(name not in os.environ for name in PROCESS_TUNING):
        # Read by the C library and OpenMP before the first line of Python.
        os.execve(sys.executable, sys.orig_argv, {**PROCESS_TUNING, **os.environ})

    flush_denormals()
    named = [(style, 1.0) for style in options.styles]
    named += [("shipped", factor) for factor in options.scales]
    named += [("speed", factor) for factor in SPEED_SCALES if options.speed]
    done = read(options.results)
    results, left_out = [], []
    for style, factor in named:
        missing = missing_package(style)
        if missing is not None:
            left_out.append(f"{style}: {missing} is not installed")
            continue
        for seed in options.seeds:
            case = Case(style, factor, seed)
            if case not in done:
                steps = train(case, options)
                done[case] = Result(case, steps)
                append(options.results, done[case])
            results.append(done[case])
            print(f"{case.name:24} seed {seed}: {done[case].steps} steps", file=sys.stderr)
    figures = report(results, left_out)
    for name, median in figures["medians"].items():
        print(f"{name:24} {median}", file=sys.stderr)
    print(f"scales {figures['scales_ratio']}, missed: {figures['missed']}", file=sys.stderr)
    if options.json:
        print(json.dumps(figures))
    return int(bool(figures["missed"]))


def missing_package(style: str) -> str | None:
    """What a style needs and is not installed."""
    package = NEEDS.get(style)
    return package if package and importlib.util.find_spec(package) is None else None


def train(case: Case, options: argparse.Namespace) -> int | None:
    """Train until the first full evaluation lap.

    Returns:
        Steps learned from until then, None if the limit came first.
    """
    environment = {
        "DR_WORLD_NAME": options.world,
        "DR_TRACKS_DIR": "",
        "DR_TORCH_PRECISION": options.precision,
    }
    folder = SHIPPED_FILES / "rewards" / "speed" if case.style == "speed" else SHIPPED_FILES
    network = json.loads((folder / "model_metadata.json").read_text("utf-8"))["neural_network"]
    work = Work.load(environment, network, options.threads, folder)
    if case.style not in ("shipped", "speed"):
        work = replace(work, reward_file=STYLES / f"{case.style}.py")
    training = MemoryTraining(replace(work, reward_factor=case.factor), case.seed, TRIALS)
    try:
        while training.steps < options.cap:
            before = training.steps
            training.iterate()
            if any(episode.completed for episode in training.evaluation):
                return before
    finally:
        training.close()
    return None


def report(results: Sequence[Result], left_out: Iterable[str]) -> dict[str, Any]:
    """Medians by name, and which bars were missed; a training without a lap counts as endless."""
    steps: dict[str, list[float]] = {}
    for result in results:
        endless = float("inf") if result.steps is None else result.steps
        steps.setdefault(result.case.name, []).append(endless)
    styles = {r.case.name for r in results if r.case.style not in ("shipped", "speed")}
    lapping = [name for name, own in steps.items() if share_of_laps(own) >= LAPPING_SHARE]
    missed = [f"{name}: laps in too few seeds" for name in steps if name not in lapping]
    medians = {name: statistics.median(own) for name, own in steps.items()}
    scales = [medians[r.case.name] for r in results if r.case.style == "shipped"]
    ratio = max(scales) / min(scales) if scales and max(scales) < float("inf") else None
    if ratio is not None and ratio > SCALES_RATIO:
        missed.append(f"scales: {ratio:.2f} instead of {SCALES_RATIO}")
    return {
        "medians": {name: m if m < float("inf") else None for name, m in medians.items()},
        "styles_that_lap": sorted(styles & set(lapping)),
        "scales_ratio": ratio,
        "missed": [*missed, *left_out],
    }


def share_of_laps(steps: Sequence[float]) -> float:
    """Share of the seeds that reached a lap."""
    return sum(count < float("inf") for count in steps) / len(steps)


def read(path: Path | None) -> dict[Case, Result]:
    """What was measured before."""
    if path is None or not path.exists():
        return {}
    lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    found = [Result(Case(**line["case"]), line["steps"]) for line in lines]
    return {result.case: result for result in found}


def append(path: Path | None, result: Result) -> None:
    """Write a result down at once: the benchmark may be stopped."""
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(result)) + "\n")


if __name__ == "__main__":
    sys.exit(main())

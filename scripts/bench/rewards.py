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
import statistics
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from learn_runs import SHIPPED_FILES, MemoryTraining, Work, become_like_a_worker
from machine import print_json
from steps_to_lap import TRIALS, add_options, append, checkpoints, records, settings_of

STYLES = Path(__file__).resolve().parent / "reward_styles"

NEEDS = {"numpy_gaussian": "numpy", "shapely_corridor": "shapely"}
"""What a style imports."""

SCALES = (0.001, 0.01, 1.0, 100.0, 10_000.0)
SPEED_SCALES = (0.1, 1.0)
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
    add_options(parser, cap=60_000)
    options = parser.parse_args()
    become_like_a_worker()
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
        print_json(figures)
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
    folder = SHIPPED_FILES / "rewards" / "speed" if case.style == "speed" else SHIPPED_FILES
    network = json.loads((folder / "model_metadata.json").read_text("utf-8"))["neural_network"]
    work = Work.load(settings_of(options), network, options.threads, folder)
    if case.style not in ("shipped", "speed"):
        work = replace(work, reward_file=STYLES / f"{case.style}.py")
    training = MemoryTraining(replace(work, reward_factor=case.factor), case.seed, TRIALS)
    found = checkpoints(training, options.cap)
    return next((steps for steps, completed in found if any(completed)), None)


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
    found = [Result(Case(**record["case"]), record["steps"]) for record in records(path)]
    return {result.case: result for result in found}


if __name__ == "__main__":
    sys.exit(main())

"""Time until the car laps: whole trainings with several seeds, and their medians.

    python scripts/bench lap --seeds 5 [--world NAME] [--tracks-dir DIR] [--minutes 6] [--json]

Every seed is a run of the real commands (`dr-start-training`, `dr-evaluate`) in an empty folder,
with the shipped files and the embedded bucket. With --json the last line of stdout is one object
with `seeds` (a list) and `median`, each holding

    first_evaluation_lap_s    wall time from the command until a checkpoint with a completed
                              evaluation lap had been learned from, at the latest
    first_evaluation_lap_steps  steps driven until then
    first_evaluation_lap_processor_s  processor time of supervisor, trainer and simulation workers
                              until that was seen, start-up included; divided by the cores, about
                              the wall time on a machine that does nothing else
    first_training_lap_s      wall time from the command to the first full training lap
    first_training_lap_steps  steps driven by the end of that iteration
    three_evaluation_laps_s   wall time from the command until all evaluation laps of a checkpoint
                              (at least three) were completed
    steps_per_s               steps learned from per second of wall time, over the whole run
    exchange_share            share of the wall time that neither driving nor learning explains
    evaluation_laps           of the 3 laps that `dr-evaluate` then drives with the best checkpoint
    lap_s                     the fastest of them, simulated seconds

A number is null where the run ended before it was reached.
"""

import argparse
import contextlib
import csv
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
from machine import print_json

from drcli.bucket.server import server
from drcli.config.loading import load_settings

PROJECT = Path(__file__).resolve().parents[2]
FIGURES = (
    "first_evaluation_lap_s",
    "first_evaluation_lap_steps",
    "first_evaluation_lap_processor_s",
    "first_training_lap_s",
    "first_training_lap_steps",
    "three_evaluation_laps_s",
    "steps_per_s",
    "exchange_share",
    "evaluation_laps",
    "lap_s",
)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5, help="how many runs")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--tracks-dir", default="", help="folder with community routes")
    parser.add_argument("--minutes", type=float, default=6.0, help="longest training")
    parser.add_argument("--custom-files", type=Path, help="folder of files to train with instead")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()

    results = []
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        result = run_seed(seed, arguments)
        results.append(result)
        print(f"seed {seed}: {json.dumps(result)}", file=sys.stderr, flush=True)
    median = {name: _median([result[name] for result in results]) for name in FIGURES}
    print(f"median: {json.dumps(median)}", file=sys.stderr)
    if arguments.json:
        print_json({"seeds": results, "median": median})


def run_seed(seed: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Train once from nothing and measure."""
    with tempfile.TemporaryDirectory(prefix="bench-lap-") as place:
        folder = Path(place)
        for file in ("run.env", "system.env"):
            shutil.copy(PROJECT / file, folder / file)
        if arguments.custom_files:
            (folder / "custom_files").mkdir()
            for shipped in (PROJECT / "defaults").glob("*.*"):
                own = arguments.custom_files / shipped.name
                shutil.copy(own if own.exists() else shipped, folder / "custom_files")
        environment = {
            **os.environ,
            "DR_WORLD_NAME": arguments.world,
            "DR_TRACKS_DIR": str(Path(arguments.tracks_dir).absolute())
            if arguments.tracks_dir
            else "",
        }
        begin = time.time()
        _dr(folder, environment, "start-training", "-q", "--seed", str(seed))
        status, processor_s = _watch(folder, environment, begin + 60.0 * arguments.minutes)
        _dr(folder, environment, "stop-training")
        evaluation = json.loads(
            _dr(folder, environment, "evaluate", "--json", check=False).splitlines()[-1]
        )
        result = _figures(folder, status, begin)
        trials = evaluation["trials"]
        done = [t["lap_s"] for t in trials if t["status"] == "Lap complete"]
        result["first_evaluation_lap_processor_s"] = processor_s
        result |= {"seed": seed, "evaluation_laps": len(done), "lap_s": min(done, default=None)}
        stop_storage(folder)
        return result


def _watch(
    folder: Path, environment: dict[str, str], deadline: float
) -> tuple[dict[str, Any], float | None]:
    """Wait until the car has lapped in training and in evaluation.

    Looks at the learning curve in the bucket's folder, because a command every second would take
    time from the training on a small machine.

    Returns:
        The status at that moment, and processor seconds until the first evaluation lap was seen.
    """
    spent: dict[int, float] = {}
    processor_s = None
    while time.time() < deadline:
        spent |= _processor_times(folder)
        for curve in (folder / "data" / "s3").rglob("metrics/history.json"):
            try:
                history = json.loads(curve.read_text())["iterations"]
            except ValueError:  # being replaced
                continue
            if processor_s is None and any(record["evaluation_lap_s"] for record in history):
                processor_s = sum(spent.values())
            if _scored(history) and any(record["full_laps"] for record in history):
                deadline = 0.0
        time.sleep(0.5)
    status: dict[str, Any] = json.loads(
        _dr(folder, environment, "status", "--json").splitlines()[-1]
    )
    return status, processor_s


def _processor_times(folder: Path) -> dict[int, float]:
    """Processor seconds of each process of the training so far, by its number."""
    try:
        supervisor = json.loads((folder / "data" / "runs" / "0" / "run.json").read_text())["pid"]
        processes = [psutil.Process(supervisor)]
        processes += processes[0].children(recursive=True)
    except (OSError, ValueError, KeyError, psutil.Error):
        return {}  # not there yet, being replaced, or ended
    times = {}
    for process in processes:
        with contextlib.suppress(psutil.Error):
            spent = process.cpu_times()
            times[process.pid] = spent.user + spent.system
    return times


def _scored(history: list[dict[str, Any]]) -> dict[str, Any] | None:
    """The first iteration whose checkpoint completed all its evaluation laps, at least three."""
    return next(
        (
            record
            for record in history
            if len(record["evaluation_lap_s"]) >= 3
            and len(record["evaluation_lap_s"]) == len(record["evaluation_progress"])
        ),
        None,
    )


def _figures(folder: Path, status: dict[str, Any], begin: float) -> dict[str, Any]:
    history = status["history"]
    first_lap_at, steps = _first_lap(folder, status)
    scored = _scored(history)
    # `elapsed_s` of a record is the end of its update; the evaluation of its checkpoint ends at
    # about the same time. The rest of the command's time comes before the training.
    start_up_s = status["started_at"] - begin
    cycle_s = [r["steps"] / r["steps_per_s"] for r in history]
    lapped = next((record for record in history if record["evaluation_lap_s"]), None)
    return {
        "first_evaluation_lap_s": lapped["elapsed_s"] + start_up_s if lapped else None,
        "first_evaluation_lap_steps": lapped["total_steps"] if lapped else None,
        "first_training_lap_s": first_lap_at - begin if first_lap_at else None,
        "first_training_lap_steps": steps,
        "three_evaluation_laps_s": scored["elapsed_s"] + start_up_s if scored else None,
        "steps_per_s": history[-1]["total_steps"] / sum(cycle_s),
        "exchange_share": sum(r["exchange_s"] for r in history) / sum(cycle_s),
    }


def _first_lap(folder: Path, status: dict[str, Any]) -> tuple[float | None, int | None]:
    """Wall clock of the first completed training lap, and the steps until then."""
    traces = folder / "data" / "s3" / status["bucket"] / status["prefix"] / "training-simtrace"
    steps = 0
    for iteration in range(len(list(traces.glob("*-iteration.csv")))):
        with (traces / f"{iteration}-iteration.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        steps += sum(row["episode_status"] != "prepare" for row in rows)
        laps = [r for r in rows if r["episode_status"] == "lap_complete"]
        if laps:
            return max(float(row["wall_clock"]) for row in laps[:1]), steps
    return None, None


def command_of(*words: str) -> list[str]:
    """A command of ours, beside the interpreter."""
    return [str(Path(sys.executable).parent / "dr"), *words]


def _dr(
    folder: Path, environment: dict[str, str], command: str, *options: str, check: bool = True
) -> str:
    done = subprocess.run(
        command_of(command, *options),
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=check,
    )
    return done.stdout


def stop_storage(folder: Path) -> None:
    """Stop the embedded server of a folder."""
    server.stop(load_settings(folder).storage)


def _median(values: list[float | None]) -> float | None:
    numbers = [value for value in values if value is not None]
    return statistics.median(numbers) if len(numbers) == len(values) else None


if __name__ == "__main__":
    main()

"""Shipped hyperparameters compared with those of the guides: steps until the first full lap.

    python scripts/bench guide_values [--case NAME ...] [--seeds 1 2 3] [--results FILE]
        [--cap 30000] [--threads 1] [--precision fp32] [--json]

The shipped files are trained as they are, and with the values that guides for DeepRacer recommend:
each of CASES. Each training drives and learns in this process as the workers do. Every checkpoint
drives five evaluation laps; the training ends when all five are completed, or at --cap steps. Only
steps count, so other programs make it slower and change nothing.

With --results each finished training is appended to a file, one JSON object a line. A training that
is already in the file is not repeated.

With --json the last line of stdout is one object: for each case

    first_lap    steps by seed until a checkpoint completed one of five evaluation laps, or null
    all_laps     steps by seed until a checkpoint completed all five, or null
    cpu_s        processor time of a training, mean, seconds
"""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from learn_runs import SHIPPED_FILES, MemoryTraining, Work, become_like_a_worker
from machine import print_json
from steps_to_lap import TRIALS, add_options, append, checkpoints, records, settings_of

CASES: Mapping[str, Mapping[str, Any]] = {
    "shipped": {},
    "discount 0.99": {"discount_factor": 0.99},
    "discount 0.999": {"discount_factor": 0.999},
    "lr 0.0003": {"lr": 0.0003},
    "epochs 10": {"num_epochs": 10},
    "guides": {"discount_factor": 0.99, "lr": 0.0003},
    "guides, 10 epochs": {"discount_factor": 0.99, "lr": 0.0003, "num_epochs": 10},
}
"""What differs from the shipped hyperparameters.json, by the name of the case."""


@dataclass(frozen=True)
class Result:
    """One training.

    Attributes:
        case: Its name in `CASES`.
        seed: Of the training.
        first_lap: Steps learned from by the first checkpoint that completed an evaluation lap.
        all_laps: The same for all evaluation laps. None: not before the limit.
        cpu_s: Processor time, seconds.
    """

    case: str
    seed: int
    first_lap: int | None
    all_laps: int | None
    cpu_s: float


def main() -> None:
    """Train, and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--case", nargs="+", default=list(CASES), choices=CASES, metavar="NAME")
    add_options(parser, cap=30_000)
    options = parser.parse_args()
    become_like_a_worker()
    results = [Result(**record) for record in records(options.results)]
    for seed in options.seeds:
        for case in options.case:
            if any((done.case, done.seed) == (case, seed) for done in results):
                continue
            results.append(train(case, seed, options))
            append(options.results, results[-1])
            print(results[-1], file=sys.stderr, flush=True)
    if options.json:
        print_json(report(results))


def train(case: str, seed: int, options: argparse.Namespace) -> Result:
    """Train until a checkpoint completes all evaluation laps, or until the limit."""
    metadata = json.loads((SHIPPED_FILES / "model_metadata.json").read_text("utf-8"))
    work = Work.load(settings_of(options), metadata["neural_network"], options.threads)
    started_s = time.process_time()
    training = MemoryTraining(work.changed(CASES[case]), seed, TRIALS)
    first = every = None
    for steps, completed in checkpoints(training, options.cap):
        first = steps if first is None and any(completed) else first
        if all(completed):
            every = steps
            break
    return Result(case, seed, first, every, round(time.process_time() - started_s, 1))


def report(results: Sequence[Result]) -> dict[str, Any]:
    """Steps by seed, and mean processor time, of each case."""
    figures: dict[str, Any] = {}
    for case in dict.fromkeys(result.case for result in results):
        own = sorted((r for r in results if r.case == case), key=lambda result: result.seed)
        figures[case] = {
            "first_lap": {result.seed: result.first_lap for result in own},
            "all_laps": {result.seed: result.all_laps for result in own},
            "cpu_s": round(sum(result.cpu_s for result in own) / len(own), 1),
        }
    return figures


if __name__ == "__main__":
    main()

"""Changes of the speed example compared: steps until all evaluation laps are fast.

    python scripts/bench fast_lap [--case NAME ...] [--seeds 1 2 3 4 5] [--results FILE]
        [--files FOLDER] [--cap 40000] [--threads 1] [--precision auto] [--json]

`defaults/rewards/speed`, or the three files in another folder, are trained as they are, and with
each of CASES. Each training drives and learns in this process as the workers do. Every checkpoint
drives five evaluation laps, and what counts is the slowest of them. Only steps count, so other
programs make it slower and change nothing.

With --results each finished training is appended to a file, one JSON object a line. A training that
is already in the file is not repeated.

With --json the last line of stdout is one object: for each case

    until        for each of 10.0, 9.0, 8.0 and 7.5 s: steps by seed until all five evaluation laps
                 of a checkpoint took at most so long, or null
    best_s       the slowest of five evaluation laps of the best checkpoint, by seed
    share        of the checkpoints of the last third: how many completed all five laps in at most
                 9.0 s, by seed
    cpu_s        processor time of a training, mean, seconds
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learn_runs import SHIPPED_FILES, MemoryTraining, Work, become_like_a_worker
from machine import print_json
from steps_to_lap import TRIALS, add_options, append, records, settings_of

FOLDER = SHIPPED_FILES / "rewards" / "speed"

GOALS_S = (10.0, 9.0, 8.0, 7.5)

STEADY_S = 9.0

CASES: Mapping[str, Mapping[str, Any]] = {
    "shipped": {},
    "critic state": {"critic": "state"},
    "discount 0.97": {"discount_factor": 0.97},
    "discount 0.98": {"discount_factor": 0.98},
    "lambda 0.8": {"gae_lambda": 0.8},
    "lambda 0.95": {"gae_lambda": 0.95},
    "entropy 0.005": {"beta_entropy": 0.005},
    "entropy 0": {"beta_entropy": 0.0},
    "lr 0.0005": {"lr": 0.0005},
    "schedule 100000": {"schedule_steps": 100_000},
    "batch 32": {"batch_size": 32},
    "batch 128": {"batch_size": 128},
    "epochs 5": {"num_epochs": 5},
    "epochs 2": {"num_epochs": 2},
    "episodes 20": {"num_episodes_between_training": 20},
    "episodes 40": {"num_episodes_between_training": 40},
    "target_kl 0.03": {"target_kl": 0.03},
    "clip 0.1": {"clip_range": 0.1},
    "clip 0.3": {"clip_range": 0.3},
    "no gradient limit": {"max_grad_norm": None},
    "mean squared error": {"loss_type": "mean squared error"},
    "bootstrap": {"bootstrap_cut": True},
}
"""What differs from the example's hyperparameters.json, by the name of the case."""


@dataclass(frozen=True)
class Result:
    """One training.

    Attributes:
        case: Its name in `CASES`.
        seed: Of the training.
        checkpoints: For each: the steps it was learned from, and the slowest of its evaluation
            laps in seconds, None if one was not completed.
        cpu_s: Processor time, seconds.
    """

    case: str
    seed: int
    checkpoints: list[tuple[int, float | None]]
    cpu_s: float

    def until(self, goal_s: float) -> int | None:
        """Steps until the slowest evaluation lap took at most so long."""
        return next((steps for steps, s in self.checkpoints if s is not None and s <= goal_s), None)

    @property
    def best_s(self) -> float | None:
        """The slowest evaluation lap of the best checkpoint."""
        return min((s for _, s in self.checkpoints if s is not None), default=None)

    @property
    def steady(self) -> float:
        """Share of the checkpoints of the last third with laps of at most `STEADY_S`."""
        last = self.checkpoints[2 * len(self.checkpoints) // 3 :]
        return round(sum(s is not None and s <= STEADY_S for _, s in last) / len(last), 2)


def main() -> None:
    """Train, and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--case", nargs="+", default=list(CASES), choices=CASES, metavar="NAME")
    parser.add_argument("--files", type=Path, default=FOLDER, help="folder of what is trained")
    add_options(parser, cap=40_000)
    parser.set_defaults(seeds=[1, 2, 3, 4, 5], precision="auto")
    options = parser.parse_args()
    become_like_a_worker()
    results = [Result(**record) for record in records(options.results)]
    for case in options.case:
        for seed in options.seeds:
            if any((done.case, done.seed) == (case, seed) for done in results):
                continue
            results.append(train(case, seed, options))
            append(options.results, results[-1])
            print(case, seed, summary([results[-1]]), file=sys.stderr, flush=True)
    if options.json:
        cases = dict.fromkeys(result.case for result in results)
        print_json({case: summary([r for r in results if r.case == case]) for case in cases})


def train(case: str, seed: int, options: argparse.Namespace) -> Result:
    """Train until the limit."""
    work = Work.load(settings_of(options), None, options.threads, options.files)
    started_s = time.process_time()
    training = MemoryTraining(work.changed(CASES[case]), seed, TRIALS)
    checkpoints: list[tuple[int, float | None]] = []
    try:
        while training.steps < options.cap:
            steps = training.steps
            training.iterate()
            laps = [e.duration_s if e.completed else None for e in training.evaluation]
            slowest = None if None in laps else max(s for s in laps if s is not None)
            checkpoints.append((steps, slowest))
    finally:
        training.close()
    return Result(case, seed, checkpoints, round(time.process_time() - started_s, 1))


def summary(results: Sequence[Result]) -> dict[str, Any]:
    """The figures of one case."""
    own = sorted(results, key=lambda result: result.seed)
    return {
        "until": {goal: {r.seed: r.until(goal) for r in own} for goal in GOALS_S},
        "best_s": {r.seed: r.best_s for r in own},
        "share": {r.seed: r.steady for r in own},
        "cpu_s": round(sum(r.cpu_s for r in own) / max(1, len(own)), 1),
    }


if __name__ == "__main__":
    main()

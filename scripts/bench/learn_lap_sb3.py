"""Stable-Baselines3's PPO until its first evaluation lap. Needs that library.

    python scripts/bench learn_lap_sb3 [--seed 1] [--cars 32] [--minutes 10] [--lend] [--world NAME]

Our cars, track, reward, network and hyperparameters. After every iteration of 1,024 steps, five
laps are driven with the most likely actions from starts spread over the lap, as our trainings do;
that time does not count. The last line of stdout is one object with `first_evaluation_lap_s`, wall
time from the start of the process, and `first_evaluation_lap_steps`; both null after --minutes.
"""

import argparse
import json
import os
import sys
import time

import numpy as np
import psutil
from learn_peer_sb3 import Sb3Training
from learn_peers import STEPS, Choice
from learn_runs import Work, become_like_a_worker

from drsim import Simulation

TRIALS = 5


def main() -> None:
    """Train and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cars", type=int, default=32, help="cars side by side")
    parser.add_argument("--minutes", type=float, default=10.0, help="longest training")
    parser.add_argument("--network", default="COMPACT_CONVOLUTIONAL_NETWORK")
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--lend", action="store_true", help="lend it our process settings")
    options = parser.parse_args()
    if options.lend:
        become_like_a_worker()

    environment = {"DR_WORLD_NAME": options.world, "DR_TORCH_PRECISION": "fp32"}
    work = Work.load(environment, options.network, os.cpu_count() or 1)
    training = Sb3Training(work, STEPS, Choice(options.cars), seed=options.seed)
    judge = work.simulation(TRIALS)
    spent_s, steps = time.time() - psutil.Process().create_time(), 0
    found: float | None = None
    while found is None and spent_s < 60.0 * options.minutes:
        pace = training.iterate()
        spent_s, steps = spent_s + pace.seconds, steps + pace.steps
        progress = evaluate(training, work, judge)
        print(f"{spent_s:.1f} s, {steps} steps, evaluation {progress}", file=sys.stderr, flush=True)
        if max(progress) >= 100.0:
            found = spent_s
    training.close()
    judge.close()
    print(
        json.dumps(
            {
                "first_evaluation_lap_s": found,
                "first_evaluation_lap_steps": steps if found is not None else None,
            }
        )
    )


def evaluate(training: Sb3Training, work: Work, judge: Simulation) -> list[float]:
    """Progress of each evaluation lap, percent."""
    result = judge.reset(np.arange(TRIALS), np.arange(TRIALS) / TRIALS)
    progress = np.zeros(TRIALS)
    going = np.ones(TRIALS, np.bool_)
    while going.any():
        result = judge.step(*work.actions.requests(training.likeliest(judge.frames)))
        progress[going] = result.progress[going]
        going &= ~result.done
    return [round(float(value), 1) for value in progress]


if __name__ == "__main__":
    main()

"""Others' trainings on our cars until their first evaluation lap, or until laps are fast enough.

    python scripts/bench learn_lap_sb3 [--peer sb3-ppo] [--lap-time S] [--reward FOLDER] [--seed 1]
        [--cars 32] [--minutes 10] [--lend] [--world NAME]

`--peer` is Stable-Baselines3's PPO (sb3-ppo) or SAC (sb3-sac), which need that library, or PPO in
the manner of CleanRL (cleanrl). They have our cars, track, reward, actions, network and, for PPO,
hyperparameters: those of the shipped files, or of the three files in --reward. They compute in
float32, as they come. After every iteration of 1,024 steps, 128 with SAC, laps are driven with the
most likely actions; that time does not count.

Without --lap-time, five laps are driven from starts spread over the lap. The last line of stdout is
one object with `first_evaluation_lap_s`, wall time from the start of the process, and
`first_evaluation_lap_steps`; both null after --minutes.

With --lap-time, 20 laps from fresh starts must be clean and take at most so long, and then 38 of 40
others, as goals of our trainings ask for. An iteration that ends after --minutes does not count.
Then the policy drives 40 more, or the last one if none was good enough. The object has `peer`, and
the names of `bench goal`: `seed`, `train_s` and `cpu_s` from the start of the process, `steps`,
`reached`, and of the 40 last laps `clean`, `kept` and `median_s`.
"""

import argparse
import importlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import psutil
from goal import FRESH_SEED
from learn_peers import STEPS, Choice, Training
from learn_runs import SHIPPED_FILES, Work, become_like_a_worker
from numpy.typing import NDArray

from drcli.drive.driving import Plan
from drcli.drive.evaluator import fresh_starts
from drcli.records.iteration import CONFIRMING_CLEAN, CONFIRMING_LAPS, Laps
from drcli.train.training_simulation import CONFIRMATION_STRIDE
from drsim import Simulation, Status
from drsim.car.car import CONTROL_HZ

PEERS = {
    "sb3-ppo": ("learn_peer_sb3", "Sb3Training"),
    "sb3-sac": ("learn_peer_sb3", "Sb3SacTraining"),
    "cleanrl": ("learn_peer_cleanrl", "CleanRlTraining"),
}
"""Module and class of each. Modules are imported late, because a library may be missing."""

TRIALS = 5
"""Evaluation laps without a lap time."""

EVALUATION_LAPS = 20
"""Those with one: as many as trainings that end at a lap time drive."""


class PeerTraining(Training, Protocol):
    """A training whose policy can be judged."""

    def likeliest(self, frames: NDArray[np.uint8]) -> NDArray[Any]:
        """The most likely actions, (n,) or (n, dims), for frames of shape (n, 1, 120, 160)."""


def main() -> None:
    """Train and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--peer", choices=PEERS, default="sb3-ppo")
    parser.add_argument("--lap-time", type=float, help="train until laps take at most so long")
    parser.add_argument("--reward", type=Path, default=SHIPPED_FILES, help="folder of three files")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cars", type=int, default=32, help="cars side by side")
    parser.add_argument("--minutes", type=float, default=10.0, help="longest training")
    parser.add_argument("--network", help="instead of the one in the files")
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--lend", action="store_true", help="lend it our process settings")
    options = parser.parse_args()
    if options.lend:
        become_like_a_worker()

    environment = {"DR_WORLD_NAME": options.world, "DR_TORCH_PRECISION": "fp32"}
    work = Work.load(environment, options.network, os.cpu_count() or 1, options.reward)
    module, name = PEERS[options.peer]
    make = getattr(importlib.import_module(module), name)
    training: PeerTraining = make(work, STEPS, Choice(options.cars), seed=options.seed)
    spent_s, cpu_s = time.time() - psutil.Process().create_time(), time.process_time()
    steps, reached = 0, False
    judge = work.simulation(CONFIRMING_LAPS)
    drive = partial(drive_laps, training, work, judge)
    while not reached and spent_s < 60.0 * options.minutes:
        cpu_before_s = time.process_time()
        pace = training.iterate()
        cpu_s += time.process_time() - cpu_before_s
        spent_s, steps = spent_s + pace.seconds, steps + pace.steps
        print(f"{spent_s:.1f} s, {steps} steps", file=sys.stderr, flush=True)
        if options.lap_time is None:
            reached = drive(spread_starts(TRIALS)).clean > 0
        elif spent_s < 60.0 * options.minutes:
            seeds = (options.seed, options.seed + CONFIRMATION_STRIDE * steps)
            reached = holds(
                lambda count, seed: drive(fresh_starts(work.track, count, seed), options.lap_time),
                options.lap_time,
                seeds,
            )
    if options.lap_time is None:
        found = {
            "first_evaluation_lap_s": spent_s if reached else None,
            "first_evaluation_lap_steps": steps if reached else None,
        }
    else:
        fresh = drive(fresh_starts(work.track, CONFIRMING_LAPS, FRESH_SEED + options.seed))
        found = {
            "peer": options.peer,
            "seed": options.seed,
            "train_s": round(spent_s, 1),
            "cpu_s": round(cpu_s, 1),
            "steps": steps,
            "reached": reached,
            "clean": fresh.clean,
            "kept": fresh.within(options.lap_time).clean,
            "median_s": fresh.median_s,
        }
    training.close()
    judge.close()
    print(json.dumps(found))


def holds(drive: Callable[[int, int], Laps], lap_time_s: float, seeds: tuple[int, int]) -> bool:
    """Whether a policy laps so fast: in all laps of an evaluation, and then in most of others.

    Args:
        drive: Drives so many laps from starts of a seed.
        lap_time_s: What a lap may take.
        seeds: Of the starts of the evaluation, and of the others.
    """
    wanted = ((EVALUATION_LAPS, EVALUATION_LAPS), (CONFIRMING_LAPS, CONFIRMING_CLEAN))
    return all(
        drive(count, seed).within(lap_time_s).clean >= fewest
        for (count, fewest), seed in zip(wanted, seeds, strict=True)
    )


def spread_starts(count: int) -> list[Plan]:
    """Starts on the centre line, equally far from each other."""
    return [Plan(number, "evaluation", number / count) for number in range(count)]


def drive_laps(
    training: PeerTraining,
    work: Work,
    judge: Simulation,
    plans: Sequence[Plan],
    most_s: float = math.inf,
) -> Laps:
    """Drive a lap from each start, with the most likely actions.

    Args:
        training: Whose policy drives.
        work: What is trained.
        judge: Cars, at least one for each start.
        plans: The starts.
        most_s: Nobody drives on after so many simulated seconds.
    """
    cars = np.arange(len(plans))
    judge.reset(
        cars,
        np.array([plan.start_fraction for plan in plans]),
        offset_m=np.array([plan.offset_m for plan in plans]),
        angle_deg=np.array([plan.angle_deg for plan in plans]),
    )
    progress = np.zeros(len(plans))
    going = np.ones(len(plans), np.bool_)
    clean_s: list[float] = []
    left = min(work.rules.max_steps, most_s * CONTROL_HZ + 1)
    while going.any() and left > 0:
        result = judge.step(*work.actions.requests(training.likeliest(judge.frames)))
        progress[going] = result.progress[cars][going]
        # Any violation ends an episode, so what is complete is clean.
        complete = going & (result.status[cars] == Status.LAP_COMPLETE)
        clean_s += result.lap_time_s[cars][complete].tolist()
        going &= ~result.done[cars]
        left -= 1
    laps = Laps(len(plans), clean_s)
    print(f"  {laps}, mean progress {progress.mean():.1f} %", file=sys.stderr, flush=True)
    return laps


if __name__ == "__main__":
    main()

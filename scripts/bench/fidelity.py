"""How far a random policy gets, here and in recordings of the reference.

    python scripts/bench fidelity [--recordings DIR] [--tracks-dir DIR] [--episodes 200] [--json]

Random actions in the two configurations that recordings exist of, starting all round the lap in
turn as there. Steps and progress of an episode are compared with those of the recorded first
iterations (`DIR/NAME/training-simtrace/0-iteration.csv`), whose policy knew nothing yet either.
With --json the last line of stdout is one object: for each configuration the recorded means and
those of each policy here, with their standard errors and ratios.
"""

import argparse
import csv
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from machine import print_json
from numpy.typing import NDArray

from drsim import EpisodeRules, Simulation, Track, centre_line_reward, load_track
from drsim.car.actions import Actions, ContinuousActions, DiscreteActions
from drsim.errors import TrackError

CARS = 20
ADVANCE = 0.05
"""Share of a lap by which the start moves on from episode to episode, as recorded."""

Floats = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int], NDArray[Any]]


@dataclass(frozen=True)
class Configuration:
    """What was trained in a recording, and random policies for it."""

    world: str
    actions: Actions
    policies: dict[str, Draw]


CONFIGURATIONS = {
    "drfc-time-trial": Configuration(
        "reinvent_base",
        DiscreteActions(
            tuple((float(angle), speed) for angle in range(-30, 31, 10) for speed in (1.0, 2.0))
        ),
        {"uniform": lambda random, cars: random.integers(14, size=cars)},
    ),
    "simapp6-continuous": Configuration(
        "reInvent2019_wide_cw",
        ContinuousActions(steering_deg=(-25.0, 25.0), speed_mps=(1.0, 2.0)),
        {
            "uniform": lambda random, cars: random.uniform(-1.0, 1.0, (cars, 2)),
            # What an untrained network really does: a third of its actions lie on the limits.
            "normal": lambda random, cars: random.normal(0.0, 1.0, (cars, 2)),
        },
    ),
}


def drive(track: Track, actions: Actions, draw: Draw, episodes: int, seed: int) -> Floats:
    """Drive episodes with random actions.

    Args:
        track: Where.
        actions: What the numbers of the policy mean.
        draw: The policy.
        episodes: How many.
        seed: Seed of the policy.

    Returns:
        Steps, and progress in percent, at the end of each episode. Shape (episodes, 2).
    """
    cars = min(CARS, episodes)
    simulation = Simulation(
        track, num_cars=cars, reward_function=centre_line_reward, rules=EpisodeRules()
    )
    random = np.random.default_rng(seed)
    ends = np.zeros((episodes, 2))
    episode = np.arange(cars)  # of each car; those beyond the last one are parked
    begun = cars
    simulation.reset(episode, episode * ADVANCE)
    finished = 0
    while finished < episodes:
        row = simulation.step(*actions.requests(draw(random, cars)))
        over = np.flatnonzero(row.done)
        ends[episode[over]] = np.stack([row.steps[over], row.progress[over]], axis=1)
        finished += len(over)
        again = over[: episodes - begun]
        if len(again):
            episode[again] = np.arange(begun, begun + len(again))
            begun += len(again)
            simulation.reset(again, episode[again] * ADVANCE)
    simulation.close()
    return ends


def recorded(file: Path) -> Floats:
    """Steps and progress at the end of each recorded episode. Shape (episodes, 2)."""
    with file.open(newline="", encoding="utf-8") as lines:
        last = {row["episode"]: row for row in csv.DictReader(lines)}
    return np.array([[float(row["steps"]), float(row["progress"])] for row in last.values()])


def describe(ends: Floats) -> dict[str, float]:
    """Means and their standard errors."""
    mean, error = ends.mean(axis=0), ends.std(axis=0, ddof=1) / np.sqrt(len(ends))
    return {
        "episodes": len(ends),
        "steps": mean[0],
        "steps_error": error[0],
        "progress": mean[1],
        "progress_error": error[1],
    }


def main() -> None:
    """Drive, compare, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--recordings", type=Path, help="folder of the two recorded trainings")
    parser.add_argument(
        "--tracks-dir", type=Path, default=os.environ.get("DR_TRACKS_DIR"), help="route files"
    )
    parser.add_argument("--episodes", type=int, default=200, help="episodes of each policy")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    report: dict[str, Any] = {}
    for name, configuration in CONFIGURATIONS.items():
        try:
            track = load_track(configuration.world, options.tracks_dir)
        except TrackError as error:
            print(f"{name} is left out. {error}", file=sys.stderr)
            continue
        found: dict[str, Any] = {"world": configuration.world}
        trace = Path("training-simtrace") / "0-iteration.csv"
        if options.recordings and (options.recordings / name / trace).is_file():
            found["recorded"] = describe(recorded(options.recordings / name / trace))
        for policy, draw in configuration.policies.items():
            ends = drive(track, configuration.actions, draw, options.episodes, options.seed)
            found[policy] = describe(ends)
            if "recorded" in found:
                for column in ("steps", "progress"):
                    ratio = found[policy][column] / found["recorded"][column]
                    found[policy][f"{column}_ratio"] = ratio
        report[name] = found
        show(name, found)
    if options.json:
        print_json(report)


def show(name: str, found: dict[str, Any]) -> None:
    """Print one configuration."""
    print(f"{name} on {found['world']}")
    for policy, numbers in found.items():
        if policy == "world":
            continue
        text = (
            f"  {policy:9} {numbers['episodes']:4} episodes: "
            f"{numbers['steps']:6.2f} +- {numbers['steps_error']:.2f} steps, "
            f"{numbers['progress']:6.2f} +- {numbers['progress_error']:.2f} %"
        )
        if "steps_ratio" in numbers:
            text += f"; ratios {numbers['steps_ratio']:.3f} and {numbers['progress_ratio']:.3f}"
        print(text)


if __name__ == "__main__":
    main()

"""How faithful the car is: recorded actions replayed, and the distance to the recorded pose.

Run as `python -m drsim.replay FOLDER`, with a folder of simtrace CSV files of the reference
simulator. The floor is flat and endless, so the motion out of a pose does not depend on where the
pose is: every episode is replayed once from its start, and each window of one second compares the
replayed displacement with the recorded one, both as seen from the car at the window's start.
"""

import argparse
import csv
import itertools
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from drsim.car import (
    REFERENCE_POINT_AHEAD_M,
    CarParameters,
    Floats,
    car_model,
    motor_commands,
)

_SETTLING_ROWS = 3
"""Rows at the start of an episode whose windows are left out: the recorded car is still moving from
the episode before when it is put at its start."""


@dataclass(frozen=True)
class Recording:
    """One recorded episode; the pose of a row is the one its action starts from.

    Attributes:
        poses: x, y (metres, the point 0.14 m ahead of the origin) and yaw (radians). Shape (t, 3).
        actions: Steering in degrees and speed in m/s. Shape (t, 2).
        ends_s: Simulation time at which each row's action ended. Shape (t,).
    """

    poses: Floats
    actions: Floats
    ends_s: Floats


@dataclass(frozen=True)
class Fidelity:
    """Errors one second ahead, as medians over all windows."""

    position_m: float
    yaw_deg: float
    driven_m: float
    windows: int


def load_recordings(folder: Path) -> list[Recording]:
    """Read every episode of the simtrace files in a folder.

    Args:
        folder: Where `*-iteration.csv` files lie.

    Returns:
        The driven part of each episode, in the order of the files.

    Raises:
        ValueError: No trace file lies there.
    """
    files = sorted(folder.glob("*-iteration.csv"))
    if not files:
        raise ValueError(f"{folder} holds no *-iteration.csv file.")
    recordings = []
    for file in files:
        with file.open(newline="", encoding="utf-8") as lines:
            rows = list(csv.DictReader(lines))
        for _, group in itertools.groupby(rows, key=lambda row: row["episode"]):
            episode = list(group)
            columns = ("X", "Y", "yaw", "steer", "throttle", "tstamp")
            table = np.array([[float(row[name]) for name in columns] for row in episode])
            table[:, 2] = np.unwrap(np.radians(table[:, 2]))
            recordings.append(Recording(table[:, :3], table[:, 3:5], table[:, 5]))
    return recordings


def measure(
    recordings: list[Recording], parameters: CarParameters | None = None, ahead_s: float = 1.0
) -> Fidelity:
    """Replay recordings and compare poses one window ahead.

    Args:
        recordings: Episodes to replay.
        parameters: The car to replay them with; the defaults when left out.
        ahead_s: Length of a window in seconds.

    Returns:
        Medians over all windows of all episodes.
    """
    model = car_model(parameters)
    errors = []
    for recording in recordings:
        starts_s = np.concatenate([[np.nan], recording.ends_s[:-1]])  # of each row's action
        replayed = _replay(model, recording, parameters or CarParameters())
        for row in range(_SETTLING_ROWS, len(starts_s)):
            end = int(np.searchsorted(starts_s[row:], starts_s[row] + ahead_s - 1 / 30)) + row
            if end >= len(starts_s):
                break
            real = _seen_from(recording.poses[row], recording.poses[end])
            ours = _seen_from(replayed[row], replayed[end])
            distance = float(np.hypot(*(real - ours)[:2]))
            turn = (real[2] - ours[2] + np.pi) % (2 * np.pi) - np.pi
            errors.append((distance, abs(np.degrees(turn)), float(np.hypot(*real[:2]))))
    position_m, yaw_deg, driven_m = np.median(errors, axis=0)
    return Fidelity(float(position_m), float(yaw_deg), float(driven_m), len(errors))


def _replay(model: mujoco.MjModel, recording: Recording, parameters: CarParameters) -> Floats:
    """Poses of the replayed car at the start of every row, from the second row on. Shape (t, 3)."""
    data = mujoco.MjData(model)
    poses = np.zeros_like(recording.poses)
    steps = 0
    for row in range(1, len(poses)):
        poses[row] = _pose(data)
        steering, wheels = motor_commands(
            recording.actions[row, 0], recording.actions[row, 1], parameters
        )
        data.ctrl[:2] = steering
        data.ctrl[2:] = wheels
        until = round((recording.ends_s[row] - recording.ends_s[0]) / model.opt.timestep)
        mujoco.mj_step(model, data, until - steps)
        steps = until
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def _pose(data: mujoco.MjData) -> tuple[float, float, float]:
    w, a, b, c = data.qpos[3:7]
    yaw = np.arctan2(2 * (a * b + w * c), 1 - 2 * (b * b + c * c))
    x = data.qpos[0] + REFERENCE_POINT_AHEAD_M * np.cos(yaw)
    y = data.qpos[1] + REFERENCE_POINT_AHEAD_M * np.sin(yaw)
    return float(x), float(y), float(yaw)


def _seen_from(pose: Floats, other: Floats) -> Floats:
    dx, dy, turn = other - pose
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.array([cos * dx + sin * dy, cos * dy - sin * dx, turn])


def main() -> None:
    """Print the fidelity of the default car on a folder of recordings."""
    parser = argparse.ArgumentParser(prog="python -m drsim.replay", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with *-iteration.csv files")
    found = measure(load_recordings(parser.parse_args().folder))
    print(
        f"1 s ahead, median of {found.windows} windows ({found.driven_m:.2f} m driven): "
        f"{found.position_m:.3f} m and {found.yaw_deg:.1f} degrees off"
    )


if __name__ == "__main__":
    main()

"""A car between the rows of its trace."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drcli.video.recorded_lap import JUMP_M, RecordedLap

Floats = NDArray[np.float64]

_WHEELS_S = 0.158
"""For 63 % of a turn. Source: the reference simulator."""

_LEAN_RAD = 0.012
"""For each m/s2 to the side, for the eye."""


@dataclass(frozen=True, eq=False)
class CarMotion:
    """Where a car is at each of f frames; arrays of shape (f,).

    Attributes:
        poses: Shape (f, 3).
        row: Of the trace, at or before the frame.
        share: Of the way to the next row, 0 to 1.
    """

    poses: Floats
    row: NDArray[np.int64]
    share: Floats
    rolled_m: Floats
    wheels_deg: Floats
    roll_rad: Floats


def motion_of(lap: RecordedLap, at_s: Floats) -> CarMotion:
    last = len(lap.time_s) - 1
    row = np.clip(np.searchsorted(lap.time_s, at_s + 1e-6, side="right") - 1, 0, last)
    later = np.minimum(row + 1, last)
    step_s = np.maximum(lap.time_s[later] - lap.time_s[row], 1e-9)
    share = np.clip((at_s - lap.time_s[row]) / step_s, 0.0, 1.0)
    change = lap.poses[later] - lap.poses[row]
    # A car that was put elsewhere does not fly there.
    stays = np.hypot(change[:, 0], change[:, 1]) >= JUMP_M
    poses = lap.poses[row] + np.where(stays, 0.0, share)[:, None] * change
    moved = np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T)
    moved = np.where(moved < JUMP_M, moved, 0.0)
    frame_s = float(at_s[1] - at_s[0]) if len(at_s) > 1 else 1.0
    wheels = np.zeros(len(at_s))
    follows = 1.0 - math.exp(-frame_s / _WHEELS_S)
    wanted = np.clip(lap.steering_deg[row], -30.0, 30.0)
    for frame in range(1, len(at_s)):
        wheels[frame] = wheels[frame - 1] + follows * (wanted[frame] - wheels[frame - 1])
    turning = np.gradient(poses[:, 2]) / frame_s if len(at_s) > 1 else np.zeros(1)
    sideways = np.clip(turning * moved / frame_s, -6.0, 6.0)
    if len(sideways) > 4:
        sideways = np.convolve(sideways, np.ones(5) / 5.0, mode="same")
    return CarMotion(poses, row, share, np.cumsum(moved), wheels, _LEAN_RAD * sideways)

"""Cameras of videos: one follows a car, one looks down on the whole track."""

import math

import numpy as np

from drsim.arrays import Floats
from drsim.car.car import CONTROL_HZ
from drsim.track.track import Track
from drsim.viewing.world_view import Lens

SWING_S = 0.25
"""Assumed: the reference simulator's depends on the computer."""

CUT_M = 1.0
"""Further, a car was put somewhere else."""

_FROM_ABOVE_M = 30.0
_ROOM = 1.12


class FollowingCamera:
    """Stands behind a car and swings after it as it turns."""

    def __init__(
        self,
        *,
        back_m: float = 1.05,
        up_m: float = 0.52,
        down_rad: float = 0.27,
        field_of_view_rad: float = 1.13,
    ) -> None:
        self._back_m, self._up_m, self._down_rad = back_m, up_m, down_rad
        self._field_of_view_rad = field_of_view_rad
        self._yaw_rad = 0.0
        self._last: Floats | None = None

    def cut(self) -> None:
        """Look along the car at once."""
        self._last = None

    def lens(self, pose: tuple[float, float, float], *, step_s: float = 1.0 / CONTROL_HZ) -> Lens:
        """For a car at x, y (metres) and yaw (radians)."""
        x, y, yaw = pose
        here = np.array([x, y])
        if self._last is None or np.hypot(*(here - self._last)) > CUT_M:
            self._yaw_rad = yaw
        turn = (yaw - self._yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
        self._yaw_rad += turn * (1.0 - math.exp(-step_s / SWING_S))
        self._last = here
        cos, sin = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        pos = np.array([x - self._back_m * cos, y - self._back_m * sin, self._up_m])
        return Lens(pos, axes(self._yaw_rad, self._down_rad), self._field_of_view_rad)


def lens_above(track: Track, size: tuple[int, int]) -> Lens:
    """Has the whole track in a picture, x to the right."""
    low_x, low_y, high_x, high_y = track.bounds
    rows, columns = size
    width_m = _ROOM * max(high_x - low_x, (high_y - low_y) * columns / rows) + 0.5
    height_m = max(_FROM_ABOVE_M, width_m)
    pos = np.array([0.5 * (low_x + high_x), 0.5 * (low_y + high_y), height_m])
    angle = 2.0 * math.atan(0.5 * width_m / height_m)
    return Lens(pos, axes(0.5 * math.pi, 0.5 * math.pi), angle)


def axes(yaw_rad: float, down_rad: float) -> Floats:
    """Turned by `yaw_rad`, then tilted down: forward, left, up."""
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    cp, sp = math.cos(down_rad), math.sin(down_rad)
    return np.array([[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, 0.0, cp]])

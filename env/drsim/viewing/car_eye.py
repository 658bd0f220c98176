"""What the sensors of a car in given poses perceive."""

import math

import numpy as np

from drsim.arrays import Bytes, Floats, Singles
from drsim.car.car import CONTROL_HZ, EYES_APART_M, FRONT, CarBatch
from drsim.race.solids import Shape, Solids
from drsim.sensing.scene import build_scene, render
from drsim.sensing.sensors import Sensors, scan
from drsim.track.track import Track
from drsim.viewing.world_view import Lens

_AT_A_TIME = 64


class CarEye:
    """The sensors of a standing car, for poses that were recorded without pictures.

    A car that drives leans: its pictures were a few rows higher or lower.
    """

    def __init__(self, track: Track, shapes: tuple[Shape, ...] = ()) -> None:
        """Paint the world: 0.1 to 0.7 s, up to 55 MB."""
        self._scene = build_scene(track)
        self._shapes = shapes
        resting = CarBatch(1, 1)
        # At the origin, the lens of a resting car says where it is in every other pose.
        self._pos, self._mat = resting.lens_pos[0].copy(), resting.lens_mat[0].copy()

    def frames(self, poses: Floats, objects: Floats, eyes: int = 1) -> Bytes:
        """Grey pictures, left eye first. Shape (t, eyes, 120, 160).

        `poses` are metres and radians, shape (t, 3), `objects` those of shapes, (t, k, 3).
        """
        out = np.empty((len(poses), eyes, FRONT.rows, FRONT.columns), np.uint8)
        for first in range(0, len(poses), _AT_A_TIME):
            part = slice(first, first + _AT_A_TIME)
            pos, mat = self._lenses(poses[part])
            boxes = self._boxes(objects[part])
            for eye in range(eyes):
                to_left_m = (0.5 * (eyes - 1) - eye) * EYES_APART_M
                picture = np.empty((len(pos), FRONT.rows, FRONT.columns), np.uint8)
                render(
                    self._scene,
                    pos + to_left_m * mat[:, :, 1],
                    mat,
                    picture,
                    boxes=boxes,
                    rounding=eyes > 1,
                )
                out[part, eye] = picture
        return out

    def scans(self, poses: Floats, objects: Floats, sensors: Sensors) -> Singles:
        """Lidar values. Shape (t, values)."""
        if sensors.lidar is None:
            return np.empty((len(poses), 0), np.float32)
        rays_m = scan(
            self._scene.walls_m,
            self._scene.wall_height_m,
            self._boxes(objects),
            np.ascontiguousarray(poses[:, :2]),
            np.ascontiguousarray(poses[:, 2]),
            sensors.lidar_model,
        )
        return sensors.process(rays_m)

    def _lenses(self, poses: Floats) -> tuple[Floats, Floats]:
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        turn = np.zeros((len(poses), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = cos
        turn[:, 0, 1], turn[:, 1, 0] = -sin, sin
        turn[:, 2, 2] = 1.0
        pos = turn @ self._pos
        pos[:, :2] += poses[:, :2]
        return np.ascontiguousarray(pos), np.ascontiguousarray(turn @ self._mat)

    def _boxes(self, objects: Floats) -> np.ndarray:
        solids = Solids(len(objects), self._shapes)
        everybody = np.arange(len(objects))
        solids.move(
            everybody,
            np.ascontiguousarray(objects[:, :, :2]),
            np.ascontiguousarray(objects[:, :, 2]),
        )
        return solids.boxes


# Cameras of videos: one follows a car, one looks down on the whole track.


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

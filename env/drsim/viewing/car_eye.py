"""What the sensors of a car in given poses perceive."""

import numpy as np

from drsim.arrays import Bytes, Floats, Singles
from drsim.car.camera_mount import EYES_APART_M, FRONT
from drsim.car.car import CarBatch
from drsim.race.solids import Shape, Solids
from drsim.sensing.camera import render
from drsim.sensing.lidar import scan
from drsim.sensing.scene import build_scene
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track

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

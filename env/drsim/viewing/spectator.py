"""Spectator cameras for videos: one behind a car, one above the whole track, in colour.

Their frames are computed like those of the cars, once for each colour channel: no OpenGL is needed.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Floats
from drsim.car.camera_mount import CameraModel
from drsim.car.car import CONTROL_HZ
from drsim.race.solids import SHAPES, Shape, Solids
from drsim.sensing.camera import render
from drsim.sensing.scene import build_scene
from drsim.track.appearance import Look, look_of
from drsim.track.track import Track

Frame = NDArray[np.uint8]

CHASE = CameraModel(
    mount_m=(-1.5, 0.0, 1.0), pitch_rad=0.314, field_of_view_rad=1.13, columns=640, rows=480
)
"""The camera that follows a car. Source: the reference simulator's video camera."""

TOP_HEIGHT_M = 6.0
"""Height of the camera above the track. Source: the reference simulator's second video camera."""

TOP_ROOM = 1.25
"""Width of its picture over that of the track. Source: the same."""

TOP_FIELDS_OF_VIEW_RAD = (0.3, 2.7)
"""Its least and greatest opening angle: a picture 1.8 m and 54 m wide."""

SWING_S = 0.25
"""Time in which the camera behind a car makes up for 63 % of a turn of the car. Assumed: the
reference simulator smooths its camera by an amount that depends on the speed of the computer."""

CUT_M = 1.0
"""A car that has moved further than this between two frames was put somewhere else."""

_CHANNELS = 3
_NOTHING: Floats = np.empty((0, 3))


class Spectator:
    """Films one car and what stands around it. Frames: RGB, shape (480, 640, 3), uint8.

    Poses are x and y in metres and yaw in radians: of the car's origin, and of the point of each
    object's shape that its definition names. A frame takes about 8 ms on one core.
    """

    def __init__(
        self,
        track: Track,
        shapes: Sequence[Shape] = (),
        *,
        look: Look | None = None,
        car: Shape = SHAPES["race_car"],
    ) -> None:
        """Paint the world in colour: three pictures, 0.3 to 2 s, 54 to 165 MB.

        `shapes` stand on the track beside the car, in the order of the poses given later. Without
        `look` the track gets the appearance of the world of the same name.
        """
        look = look or look_of(track.name)
        self._scenes = [build_scene(track, look.in_channel(c)) for c in range(_CHANNELS)]
        self._shapes = tuple(shapes)
        self._solids = Solids(1, [car, *self._shapes])
        self._top_pose, self._top_camera = _above(track)
        self._behind_yaw_rad = 0.0
        self._last_xy: Floats | None = None

    def cut(self) -> None:
        """Let the next frame from behind look along the car at once, as after a change of scene."""
        self._last_xy = None

    def chase(
        self, pose: Floats, objects: Floats | None = None, *, step_s: float = 1.0 / CONTROL_HZ
    ) -> Frame:
        """The view from behind the car, which swings after it as it turns.

        `pose` is that of the car, shape (3,), `objects` those of the k shapes, shape (k, 3);
        `step_s` is the simulated time since the last such frame.

        Raises:
            ValueError: When there is not one pose for each shape.
        """
        x_m, y_m, yaw_rad = pose
        xy = np.array([x_m, y_m])
        if self._last_xy is None or np.hypot(*(xy - self._last_xy)) > CUT_M:
            self._behind_yaw_rad = yaw_rad
        turn_rad = (yaw_rad - self._behind_yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
        self._behind_yaw_rad += turn_rad * (1.0 - math.exp(-step_s / SWING_S))
        self._last_xy = xy
        back_m, _, up_m = CHASE.mount_m
        cos, sin = math.cos(self._behind_yaw_rad), math.sin(self._behind_yaw_rad)
        lens_pos = np.array([x_m + back_m * cos, y_m + back_m * sin, up_m])
        lens_mat = _axes(self._behind_yaw_rad, CHASE.pitch_rad)
        return self._film(pose, objects, lens_pos, lens_mat, CHASE)

    def top(self, pose: Floats, objects: Floats | None = None) -> Frame:
        """The view of the whole track from above, x to the right and y upwards; as `chase`."""
        return self._film(pose, objects, *self._top_pose, self._top_camera)

    def _film(
        self,
        pose: Floats,
        objects: Floats | None,
        lens_pos: Floats,
        lens_mat: Floats,
        camera: CameraModel,
    ) -> Frame:
        standing = _NOTHING if objects is None else objects
        if standing.shape != (len(self._shapes), 3):
            raise ValueError(
                f"Poses have the shape {standing.shape}, not ({len(self._shapes)}, 3): give x, y "
                "and yaw, one for each shape that the spectator was made with."
            )
        everything = np.concatenate([np.asarray(pose, np.float64)[None], standing])
        self._solids.move(np.array([0]), everything[None, :, :2], everything[None, :, 2])
        frame = np.empty((camera.rows, camera.columns, _CHANNELS), np.uint8)
        channel = np.empty((1, camera.rows, camera.columns), np.uint8)
        for index, scene in enumerate(self._scenes):
            boxes = self._solids.boxes.copy()
            boxes["color"] = boxes["color"][:, :, index, None]
            render(scene, lens_pos[None], lens_mat[None], channel, camera, boxes=boxes)
            frame[:, :, index] = channel[0]
        return frame


def _above(track: Track) -> tuple[tuple[Floats, Floats], CameraModel]:
    """Position, axes and numbers of the camera that has the whole track in view.

    The reference simulator fits the width only and cuts off tracks that are higher than 3/4 of it.
    """
    (low_x, low_y), (high_x, high_y) = track.outer.min(axis=0), track.outer.max(axis=0)
    lens_pos = np.array([0.5 * (low_x + high_x), 0.5 * (low_y + high_y), TOP_HEIGHT_M])
    width_m = max(high_x - low_x, (high_y - low_y) * CHASE.columns / CHASE.rows)
    angle_rad = 2.0 * math.atan(0.5 * TOP_ROOM * width_m / TOP_HEIGHT_M)
    least_rad, most_rad = TOP_FIELDS_OF_VIEW_RAD
    camera = replace(CHASE, field_of_view_rad=min(max(angle_rad, least_rad), most_rad))
    return (lens_pos, _axes(0.5 * math.pi, 0.5 * math.pi)), camera


def _axes(yaw_rad: float, down_rad: float) -> Floats:
    """Axes of a lens that is turned by `yaw_rad` and then tilted down: forward, left, up."""
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    cp, sp = math.cos(down_rad), math.sin(down_rad)
    return np.array([[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, 0.0, cp]])

"""Pictures of a worker: what a car sees, and the view from behind it."""

import io
import math
import threading
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drcli.base.log import get_logger
from drcli.workers.live_moment import Moment, Rider
from drsim.race.solids import SHAPES
from drsim.track.track import Track
from drsim.viewing.camera_paths import FollowingCamera
from drsim.viewing.placed_things import Thing
from drsim.viewing.world_view import WorldView

_logger = get_logger(__name__)

Rgb = tuple[float, float, float]

CAMERA_SIZE = (160, 120)
"""Columns and rows."""

NO_CAMERA = "The teacher\nsees the track,\nno camera."
CHASE_SIZE = (320, 240)
MOST_WORLDS = 2
"""Painted, up to 70 MB each: the track, and that of other evaluations."""

_QUALITY = 75
_WHEELS_RAD = math.radians(30.0)
_NOWHERE = (0.0, 0.0, 0.0)


def missing_library() -> str:
    """Why there can be no pictures; empty if there can."""
    try:
        import PIL.Image  # noqa: F401  whether it is there
    except ImportError as error:
        return f"Pictures need the package pillow, which cannot be loaded here ({error})."
    return ""


def jpeg(picture: NDArray[np.uint8]) -> bytes:
    """Grey (rows, columns) or RGB (rows, columns, 3)."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=_QUALITY)
    return file.getvalue()


def camera_picture(frames: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A car's eyes, shape (eyes, rows, columns), side by side.

    A teacher has no pixels: the picture says so.
    """
    if not frames.size:
        return _words(NO_CAMERA)
    return np.ascontiguousarray(np.concatenate(list(frames), axis=1))


@cache
def _words(text: str) -> NDArray[np.uint8]:
    from PIL import Image, ImageDraw

    columns, rows = CAMERA_SIZE
    picture = Image.new("L", CAMERA_SIZE, 40)
    draw = ImageDraw.Draw(picture)
    draw.multiline_text((columns // 2, rows // 2), text, 230, anchor="mm", align="center")
    return np.asarray(picture)


class ChaseView:
    def __init__(self) -> None:
        self._worlds: dict[tuple[str, bool], WorldView] = {}
        self._painter: threading.Thread | None = None
        self._failed: set[tuple[str, bool]] = set()
        self._cameras: dict[int, tuple[FollowingCamera, int]] = {}

    @property
    def is_painting(self) -> bool:
        return self._painter is not None and self._painter.is_alive()

    @property
    def hint(self) -> str:
        if self.is_painting:
            return "The view from behind the car is being prepared."
        if self._failed:
            return "There is no view from behind the car; the log of the worker says why."
        return ""

    def is_ready(self, track: Track) -> bool:
        """Whether a track's world is painted; if not, a thread begins.

        That takes one to two seconds of processor time.
        """
        key = (track.name, track.reverse)
        if key in self._worlds:
            return True
        if not self.is_painting and key not in self._failed:
            self._painter = threading.Thread(
                target=self._paint, args=(key, track), name="live-painter", daemon=True
            )
            self._painter.start()
        return False

    def _paint(self, key: tuple[str, bool], track: Track) -> None:
        columns, rows = CHASE_SIZE
        try:
            world = WorldView(track, columns=columns, rows=rows, threads=1)
            # A first picture compiles the kernels here, where nobody waits for it.
            lens = FollowingCamera().lens(_NOWHERE, step_s=1.0 / 15.0)
            world.frame(lens, [Thing(SHAPES["race_car"], _NOWHERE, (0.0, 0.0, 0.0), 0.0)])
        except Exception as error:  # such as no memory; the cars drive on
            self._failed.add(key)
            _logger.warning("There is no view from behind on %s.", track.name, exc_info=error)
            return
        while len(self._worlds) >= MOST_WORLDS:
            del self._worlds[next(iter(self._worlds))]
        self._worlds[key] = world

    def picture(self, moment: Moment, rider: Rider, colors: list[Rgb]) -> NDArray[np.uint8]:
        """Its world must be painted; colors from 0 to 255."""
        track, car = moment.track, rider.car
        key = (track.name, track.reverse)
        world = self._worlds[key]
        camera, last = self._cameras.setdefault(car, (FollowingCamera(), 0))
        steps = moment.result.steps.item(car)
        self._cameras[car] = camera, steps
        if steps < last:
            camera.cut()
        pose = _pose(moment.poses[car])
        lens = camera.lens(pose, step_s=max(1, steps - last) / 15.0)
        wheels = math.radians(moment.steering_deg.item(car))
        things = [
            Thing(
                SHAPES["race_car"],
                pose,
                colors[rider.racer % len(colors)],
                min(max(wheels, -_WHEELS_RAD), _WHEELS_RAD),
                rolled_m=moment.result.progress.item(car) / 100.0 * track.length_m,
            )
        ]
        for shape, place in zip(moment.shapes, moment.objects[car], strict=True):
            other = shape.name == "race_car"
            color = colors[(rider.racer + 1) % len(colors)] if other else None
            things.append(Thing(shape, _pose(place), color))
        return world.frame(lens, things)


def _pose(values: NDArray[Any]) -> tuple[float, float, float]:
    x, y, yaw = values.tolist()
    return x, y, yaw

"""Coloured pictures of a track and what stands on it, from any place, without OpenGL."""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Floats
from drsim.sensing.cuboids import TO_SUN
from drsim.track.appearance import RGB, Look, look_of
from drsim.track.track import Track
from drsim.viewing.ground_painting import measure_ground, paint_ground
from drsim.viewing.landscape import (
    HAZE,
    HAZE_M,
    STEEPEST,
    grain_of,
    landscape_of,
    paint_barriers,
    paint_horizon,
)
from drsim.viewing.meshes import has_wheels
from drsim.viewing.pixel_rows import LensParts, PixelRows, pixel_rows
from drsim.viewing.placed_objects import PlacedObject, ThingMeshes, placed
from drsim.viewing.shadow_painting import shade
from drsim.viewing.solid_painting import draw

Frame = NDArray[np.uint8]

GHOST_OPACITY = 0.42

BARRIER_M = 0.22
BEND_KERB_M = 0.07
_BANDS = 12
_BARRIER_LIGHT: RGB = (232.0, 236.0, 238.0)


@dataclass(frozen=True, eq=False)
class Lens:
    """Where a camera is; columns of `mat` are forward, left, up; the angle is horizontal."""

    pos: Floats
    mat: Floats
    field_of_view_rad: float


class WorldView:
    """Makes frames of one track. Shape (rows, columns, 3), uint8.

    Not for two threads at a time: it has threads of its own.
    """

    def __init__(
        self,
        track: Track,
        *,
        columns: int = 640,
        rows: int = 480,
        look: Look | None = None,
        threads: int = 2,
    ) -> None:
        """Measure and paint the world: 0.5 to 1 s, up to 70 MB."""
        look = look or look_of(track.name)
        self.size = (rows, columns)
        everywhere = look.kerb_width_m > 0.0
        fields = measure_ground(track, everywhere=everywhere)
        grain = grain_of(track.name)
        self._ground = (fields.cells, fields.x_m, fields.y_m, fields.cell_m, grain)
        self._marks = _marks(track, look)
        walls = tuple(float(face) for face in look.walls.around(track.bounds))
        barrier_m = BARRIER_M if look.walls.height_m > 0.0 else 0.0
        self._around = (
            landscape_of(track.name),
            STEEPEST,
            walls,
            barrier_m,
            _barrier_colors(look),
            HAZE_M,
        )
        self._palette = _palette(look)
        self._fine = 3 if columns * rows <= 640 * 480 else 2
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None
        self._meshes: ThingMeshes | None = None

    def frame(self, lens: Lens, things: Sequence[PlacedObject]) -> Frame:
        rows, columns = self.size
        solid = [thing for thing in things if not thing.ghost]
        ordered = [*solid, *(thing for thing in things if thing.ghost)]
        kinds = tuple((thing.shape, thing.color, thing.ghost) for thing in ordered)
        if self._meshes is None or self._meshes.kinds != kinds:
            self._meshes = ThingMeshes.of(kinds)
        meshes = self._meshes
        focal_px = 0.5 * columns / math.tan(0.5 * lens.field_of_view_rad)
        pos, forward, left, up = (
            _vector(values) for values in (lens.pos, *(lens.mat[:, axis] for axis in range(3)))
        )
        seen_by = (pos, forward, left, up, focal_px)
        turns, shifts = placed(ordered)
        triangles = meshes.seen(turns, shifts, seen_by, self.size)
        all_rows = pixel_rows(seen_by, self.size)
        shadows = _shadows(solid)
        out = np.empty((rows, columns, 3), np.uint8)

        def band(number: int) -> None:
            first, last = rows * number // _BANDS, rows * (number + 1) // _BANDS
            part = out[first:last]
            self._paint(seen_by, all_rows.part(first, last), shadows, part)
            if len(meshes.triangles.faces):
                counts = (meshes.solid_faces, len(meshes.triangles.faces))
                size = (rows, columns, first)
                draw(triangles, seen_by, TO_SUN, counts, GHOST_OPACITY, size, self._fine, part)

        if self._pool is None:
            for number in range(_BANDS):
                band(number)
            return out
        # The caller works, too: it takes what no other thread has begun, from the other end.
        jobs = [self._pool.submit(band, number) for number in range(_BANDS)]
        for number in reversed(range(_BANDS)):
            if jobs[number].cancel():
                band(number)
        for job in jobs:
            if not job.cancelled():
                job.result()
        return out

    def _paint(self, lens: LensParts, seen: PixelRows, shadows: Floats, out: Frame) -> None:
        pos, _, _, _, focal_px = lens
        directions, depths, below, step = seen
        mixed = np.empty(out.shape, np.float32)
        light = np.empty(out.shape[:2], np.float32)
        rows = (directions, depths, below)
        paint_horizon(self._around, step, directions, below, mixed)
        shade(shadows, _LEANING, pos, step, rows, light)
        paint_ground(self._ground, self._marks, self._palette, lens, rows, HAZE_M, light, mixed)
        paint_barriers(self._around, pos, focal_px, step, directions, mixed)
        out[:] = np.minimum(mixed + np.float32(0.5), np.float32(255.0))

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()


_LEANING = (-TO_SUN[0] / TO_SUN[2], -TO_SUN[1] / TO_SUN[2])


def _shadows(things: Sequence[PlacedObject]) -> Floats:
    rows = []
    for thing in things:
        if not thing.shape.boxes:
            continue
        x, y, yaw = thing.pose
        length_m, width_m = thing.shape.footprint_m
        high_m = max(box.high_m for box in thing.shape.boxes)
        if has_wheels(thing.shape):
            high_m *= 0.75  # of the shell; the measured height includes a mast
        else:
            box = thing.shape.boxes[0]
            length_m, width_m = box.size_m
        rows.append((x, y, math.cos(yaw), math.sin(yaw), length_m / 2, width_m / 2, high_m))
    return np.array(rows, np.float64).reshape(-1, 7)


def _marks(track: Track, look: Look) -> tuple[object, ...]:
    line = (-look.border_width_m, 0.0) if look.border_side == "out" else (0.0, look.border_width_m)
    inner, outer = track.inner[0], track.outer[0]
    if track.reverse:
        inner, outer = track.inner[-1], track.outer[-1]
    across = outer - inner
    width = float(np.hypot(*across))
    inset = look.border_width_m if look.border_side == "in" else 0.0
    depth = look.start_depth_m if width > 2.0 * inset else 0.0
    to = across / max(width, 1e-9)
    middle = 0.5 * (inner + outer)
    return (
        line,
        look.kerb_width_m or BEND_KERB_M,
        look.kerb_stripe_m,
        (look.dash_width_m, look.dash_length_m, look.dash_pitch_m, look.dash_start_m),
        (*middle.tolist(), *to.tolist(), width - 2.0 * inset, depth),
        (float(look.start_squares[0]), float(look.start_squares[1])),
    )


def _palette(look: Look) -> tuple[RGB, ...]:
    light = look.kerb_light or look.kerb
    marks = (look.road, look.line, look.dash, look.kerb, light, look.field, look.chequer)
    return tuple(_vector(color) for color in (*(paint.rgb for paint in marks), HAZE))


def _barrier_colors(look: Look) -> tuple[RGB, RGB, RGB]:
    grey = 3.4 * sum(look.walls.greys) / len(look.walls.greys)
    red, green, blue = (min(255.0, grey * tint) for tint in look.walls.tint)
    return _vector((red, green, blue)), _vector(_BARRIER_LIGHT), _vector(HAZE)


def _vector(values: Iterable[float]) -> tuple[float, float, float]:
    first, second, third = (float(value) for value in values)
    return first, second, third

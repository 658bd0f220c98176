"""Coloured pictures of a track and what stands on it, from any place, without OpenGL."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from drsim.arrays import RGB, Bytes, Floats, Singles, Vector
from drsim.jit import kernel
from drsim.sensing.cuboids import TO_SUN
from drsim.sensing.observations import pool_of, share_out
from drsim.track.appearance import Look, look_of
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
from drsim.viewing.placed_objects import PlacedObject, ThingMeshes, has_wheels, placed
from drsim.viewing.solid_painting import draw, project

LensParts = tuple[Vector, Vector, Vector, Vector, float]
"""Position in metres, forward, left and up, focal length in pixels."""


Rows = tuple[Floats, Floats, Floats]
"""Of n rows of pixels: directions of the first ones, shape (n, 3), depths of the ground along the
lens, and the part below the horizon, 0 to 1.
"""


def pixel_rows(lens: LensParts, size: tuple[int, int]) -> Rows:
    """For a lens that does not lean sideways."""
    pos, forward, to_left, to_up, focal_px = lens
    rows, columns = size
    left = (0.5 * columns - 0.5) / focal_px
    up = (0.5 * rows - (np.arange(rows) + 0.5)) / focal_px
    directions = np.stack(
        [
            forward[0] + left * to_left[0] + up * to_up[0],
            forward[1] + left * to_left[1] + up * to_up[1],
            forward[2] + up * to_up[2],
        ],
        axis=1,
    )
    # The row in which the ground ends is blended with the horizon.
    below = np.clip(0.5 - directions[:, 2] * focal_px, 0.0, 1.0)
    return directions, pos[2] / -np.minimum(directions[:, 2], -0.4 / focal_px), below


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
        fields = measure_ground(track, everywhere=look.kerb_width_m > 0.0)
        self._ground = (*fields, grain_of(track.name))
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
        self._pool = pool_of(threads)
        self._meshes: ThingMeshes | None = None

    def frame(self, lens: Lens, things: Sequence[PlacedObject]) -> Bytes:
        rows, columns = self.size
        ordered = sorted(things, key=lambda thing: thing.ghost)
        kinds = tuple((thing.shape, thing.color, thing.ghost) for thing in ordered)
        if self._meshes is None or self._meshes.kinds != kinds:
            self._meshes = ThingMeshes(kinds)
        meshes = self._meshes
        focal_px = 0.5 * columns / math.tan(0.5 * lens.field_of_view_rad)
        pos, forward, left, up = (
            _vector(values) for values in (lens.pos, *(lens.mat[:, axis] for axis in range(3)))
        )
        seen_by = (pos, forward, left, up, focal_px)
        turns, shifts = placed(ordered)
        made = meshes.triangles
        moved = project(made[:2], turns, shifts, meshes.owner, seen_by, self.size)
        triangles = (*moved, *made[2:])
        all_rows = pixel_rows(seen_by, self.size)
        shadows = _shadows([thing for thing in things if not thing.ghost])
        out = np.empty((rows, columns, 3), np.uint8)

        def band(number: int) -> None:
            first, last = rows * number // _BANDS, rows * (number + 1) // _BANDS
            part = out[first:last]
            directions, depths, below = all_rows
            band_rows = directions[first:last], depths[first:last], below[first:last]
            self._paint(seen_by, band_rows, shadows, part)
            if len(made.faces):
                counts = (meshes.solid_faces, len(made.faces))
                size = (rows, columns, first)
                draw(triangles, seen_by, TO_SUN, counts, GHOST_OPACITY, size, self._fine, part)

        share_out(self._pool, [partial(band, number) for number in range(_BANDS)])
        return out

    def _paint(self, lens: LensParts, rows: Rows, shadows: Floats, out: Bytes) -> None:
        pos, _, to_left, _, focal_px = lens
        directions, _, below = rows
        step = (-to_left[0] / focal_px, -to_left[1] / focal_px)
        mixed = np.empty(out.shape, np.float32)
        light = np.empty(out.shape[:2], np.float32)
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


_SHADE = 0.56
_FURTHEST_M = 60.0
"""Depth of shadows."""

SHADOW_X, SHADOW_Y, SHADOW_COS, SHADOW_SIN, SHADOW_LENGTH, SHADOW_WIDTH, SHADOW_HEIGHT = range(7)
"""Columns: middle, direction, half length and width, height, metres."""


@kernel
def shade(
    shadows: Floats,
    leaning: tuple[float, float],
    pos: tuple[float, float, float],
    step: tuple[float, float],
    row_parts: Rows,
    light: Singles,
) -> None:
    """The light on the ground in rows of a picture; `leaning` is per metre of height."""
    directions, depths, below = row_parts
    for row in range(len(light)):
        light[row] = np.float32(1.0)
        depth = depths[row]
        if below[row] > 0.0 and depth < _FURTHEST_M:
            at = (
                (pos[0] + depth * directions[row, 0], pos[1] + depth * directions[row, 1]),
                (depth * step[0], depth * step[1]),
            )
            for k in range(len(shadows)):
                _shade_row(shadows, k, leaning, at, light[row])


@kernel
def _shade_row(
    shadows: Floats,
    k: int,
    leaning: tuple[float, float],
    at: tuple[tuple[float, float], tuple[float, float]],
    light: Singles,
) -> None:
    middle_x, middle_y, cos, sin = shadows[k, 0], shadows[k, 1], shadows[k, 2], shadows[k, 3]
    half_length, half_width, height = shadows[k, 4], shadows[k, 5], shadows[k, 6]
    reach = half_length + half_width + 1.3 * height + 0.1
    (first_x, first_y), right = at
    # The pixels of the row that are near enough lie around the one that is nearest.
    square = right[0] * right[0] + right[1] * right[1] + 1e-18
    to_x, to_y = middle_x - first_x, middle_y - first_y
    nearest = (to_x * right[0] + to_y * right[1]) / square
    away_x, away_y = to_x - nearest * right[0], to_y - nearest * right[1]
    rest = reach * reach - away_x * away_x - away_y * away_y
    if rest <= 0.0:
        return
    around = math.sqrt(rest / square)
    begin = int(min(max(nearest - around, 0.0), float(len(light))))
    end = int(min(max(nearest + around + 1.0, 0.0), float(len(light))))
    for pixel in range(begin, end):
        x = first_x + pixel * right[0] - middle_x
        y = first_y + pixel * right[1] - middle_y
        darkest = 0.0
        for layer in range(4):
            part = layer / 3.0
            px, py = x - part * height * leaning[0], y - part * height * leaning[1]
            along = abs(px * cos + py * sin) - half_length * (1.0 - 0.25 * part)
            across = abs(py * cos - px * sin) - half_width * (1.0 - 0.20 * part)
            outside = math.hypot(max(along, 0.0), max(across, 0.0)) + min(max(along, across), 0.0)
            soft = 0.016 + 0.11 * part * height
            darkest = max(darkest, min(max(0.5 - outside / (2.0 * soft), 0.0), 1.0))
        along = abs(x * cos + y * sin) - half_length
        across = abs(y * cos - x * sin) - half_width
        outside = math.hypot(max(along, 0.0), max(across, 0.0))
        near = max(1.0 - outside / 0.07, 0.0)
        light[pixel] *= (1.0 - _SHADE * darkest) * (1.0 - 0.3 * near * near)

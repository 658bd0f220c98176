"""Paints the ground of a track as a grey picture, from signed distances to keep edges exact."""

import math
import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drsim.arrays import Bytes, Floats, Single, Singles
from drsim.jit import kernel
from drsim.track.appearance import Look, Paint
from drsim.track.polyline import without_repeats
from drsim.track.road_cells import sign_off_road
from drsim.track.track import Track

_FINE = 4
_TILE = 512
_STROKE_M = 0.010
"""Of a fibre. Source: estimated on frames of the reference simulator."""


@dataclass(frozen=True)
class Grid:
    """Texels from a lower left corner; rows go up with y."""

    x_m: float
    y_m: float
    texel_m: float
    columns: int
    rows: int


def paint_ground(track: Track, look: Look, grid: Grid) -> Bytes:
    """Greys, 0..255. Shape (rows, columns)."""
    # The picture belongs to the world: it must not change when the track is driven the other way.
    center = track.center[::-1] if track.reverse else track.center
    side = _side_of_road(track, look, grid)
    marks = np.zeros((grid.rows, grid.columns), np.uint8)
    _stamp_dashes(
        _texels(without_repeats(center), grid),
        look.dash_width_m / grid.texel_m,
        look.dash_length_m / grid.texel_m,
        look.dash_pitch_m / grid.texel_m,
        look.dash_start_m / grid.texel_m,
        marks,
    )
    line_near_m, line_far_m = 0.0, look.border_width_m
    if look.border_side == "out":
        line_near_m, line_far_m = -look.border_width_m, 0.0
    paints = _Paints(
        road=_figures(look.road),
        line=_figures(look.line),
        kerb=_figures(look.kerb),
        kerb_light=_figures(look.kerb_light or look.kerb),
        field=_figures(look.field),
        dash=_figures(look.dash),
    )
    cover = _Cover(side, marks, _stripes_of_kerb(track, look, grid, side))
    near, far = line_near_m / grid.texel_m, line_far_m / grid.texel_m
    limits = Single(near), Single(far), Single(near - look.kerb_width_m / grid.texel_m)
    ground = _mix(cover, _grain_tile(track.name, grid.texel_m), *limits, paints)
    if look.start_depth_m > 0.0:
        _paint_start(track, look, grid, ground)
    return ground


def _texels(points: Floats, grid: Grid) -> Floats:
    return np.ascontiguousarray((points - (grid.x_m, grid.y_m)) / grid.texel_m - 0.5)


def _side_of_road(track: Track, look: Look, grid: Grid) -> Singles:
    inner, outer = (_texels(without_repeats(line), grid) for line in (track.inner, track.outer))
    reach = 2.0 + (look.border_width_m + look.kerb_width_m) / grid.texel_m
    side = np.full((grid.rows, grid.columns), reach, np.float32)
    _stamp_distance(inner, track.closed, reach, side)
    _stamp_distance(outer, track.closed, reach, side)
    sign_off_road(inner, outer, track.closed, side)
    return side


@kernel
def _near(start: float, end: float, reach: float, count: int) -> tuple[int, int]:
    low, high = min(start, end) - reach, max(start, end) + reach
    return max(math.ceil(low), 0), min(math.floor(high) + 1, count)


@kernel
def _stamp_distance(line: Floats, closed: bool, reach: float, distance: Singles) -> None:
    rows, columns = distance.shape
    final = len(line) - 1
    for i in range(1, len(line)):
        ax, ay = line[i - 1]
        dx, dy = line[i, 0] - ax, line[i, 1] - ay
        square = max(dx * dx + dy * dy, 1e-12)
        first, last = _near(ay, ay + dy, reach, rows)
        left, right = _near(ax, ax + dx, reach, columns)
        for row in range(first, last):
            for column in range(left, right):
                px, py = column - ax, row - ay
                along = (px * dx + py * dy) / square
                if not closed and ((i == 1 and along < 0.0) or (i == final and along > 1.0)):
                    continue
                along = min(max(along, 0.0), 1.0)
                away = math.hypot(px - along * dx, py - along * dy)
                if away < distance[row, column]:
                    distance[row, column] = away


@kernel
def _stamp_dashes(
    line: Floats, width: float, length: float, pitch: float, start: float, marks: Bytes
) -> None:
    rows, columns = marks.shape
    reach = 0.5 * width + 1.0
    passed = -start
    for i in range(1, len(line)):
        ax, ay = line[i - 1]
        dx, dy = line[i, 0] - ax, line[i, 1] - ay
        step = math.hypot(dx, dy)
        if step == 0.0:
            continue
        dx, dy = dx / step, dy / step
        first, last = _near(ay, ay + dy * step, reach, rows)
        left, right = _near(ax, ax + dx * step, reach, columns)
        for row in range(first, last):
            for column in range(left, right):
                px, py = column - ax, row - ay
                along = px * dx + py * dy
                if along < 0.0 or along > step:
                    continue
                across = abs(px * dy - py * dx)
                beyond = (passed + along) % pitch
                # Distance to the nearest end of a dash, positive within the dash.
                within = max(min(beyond, length - beyond), beyond - pitch)
                cover = min(max(0.5 + 0.5 * width - across, 0.0), 1.0)
                cover *= min(max(0.5 + within, 0.0), 1.0)
                marks[row, column] = max(marks[row, column], np.uint8(255.0 * cover))
        passed += step


def _stripes_of_kerb(track: Track, look: Look, grid: Grid, side: Singles) -> Bytes:
    stripes = np.zeros((grid.rows, grid.columns), np.uint8)
    if look.kerb_light and look.kerb_width_m > 0.0:
        reach = 2.0 + (look.border_width_m + look.kerb_width_m) / grid.texel_m
        for line in (track.inner, track.outer):
            border = _texels(without_repeats(line[::-1] if track.reverse else line), grid)
            length = float(np.hypot(*np.diff(border, axis=0).T).sum())
            pairs = max(round(0.5 * length * grid.texel_m / look.kerb_stripe_m), 1)
            _stamp_stripes(border, reach, 0.5 * length / pairs, side, stripes)
    return stripes


@kernel
def _stamp_stripes(
    line: Floats, reach: float, stripe: float, side: Singles, stripes: Bytes
) -> None:
    rows, columns = stripes.shape
    passed = 0.0
    for i in range(1, len(line)):
        ax, ay = line[i - 1]
        dx, dy = line[i, 0] - ax, line[i, 1] - ay
        square = max(dx * dx + dy * dy, 1e-12)
        step = math.sqrt(square)
        first, last = _near(ay, ay + dy, reach, rows)
        left, right = _near(ax, ax + dx, reach, columns)
        for row in range(first, last):
            for column in range(left, right):
                px, py = column - ax, row - ay
                along = min(max((px * dx + py * dy) / square, 0.0), 1.0)
                away = math.hypot(px - along * dx, py - along * dy)
                if side[row, column] < 0.0 and away < 0.01 - side[row, column]:
                    beyond = (passed + along * step) % (2.0 * stripe)
                    within = max(min(beyond, stripe - beyond), beyond - 2.0 * stripe)
                    stripes[row, column] = np.uint8(255.0 * min(max(0.5 + within, 0.0), 1.0))
        passed += step


class _Cover(NamedTuple):
    """What covers each texel, 0..255; `side` is positive on the road."""

    side: Singles
    marks: Bytes
    stripes: Bytes


class _Paints(NamedTuple):
    road: Singles
    line: Singles
    kerb: Singles
    kerb_light: Singles
    field: Singles
    dash: Singles


def _figures(paint: Paint) -> Singles:
    return np.array([paint.grey, paint.grain], np.float32)


@kernel
def _mix(
    cover: _Cover, grain: Singles, near: Single, far: Single, kerb_end: Single, paints: _Paints
) -> Bytes:
    """From the border outwards: line between `far` and `near`, kerb to `kerb_end`, field."""
    side, marks, stripes = cover.side, cover.marks, cover.stripes
    road, line, kerb, kerb_light, field, dash = paints
    half, part = np.float32(0.5), np.float32(1.0 / 255.0)
    none, full = np.float32(0.0), np.float32(1.0)
    tile = grain.shape[0]
    rows, columns = side.shape
    ground = np.empty((rows, columns), np.uint8)
    for row in range(rows):
        for column in range(columns):
            s = side[row, column]
            past_far = min(max(half + s - far, none), full)
            past_near = min(max(half + s - near, none), full)
            past_kerb = min(max(half + s - kerb_end, none), full)
            on_line = past_near - past_far
            on_kerb = past_kerb - past_near
            on_field = full - past_kerb
            rough = grain[row % tile, column % tile]
            kerb_grey = kerb[0] + stripes[row, column] * part * (kerb_light[0] - kerb[0])
            grey = (
                past_far * (road[0] + road[1] * rough)
                + on_line * (line[0] + line[1] * rough)
                + on_kerb * (kerb_grey + kerb[1] * rough)
                + on_field * (field[0] + field[1] * rough)
            )
            grey += marks[row, column] * part * (dash[0] + dash[1] * rough - grey)
            ground[row, column] = np.uint8(min(max(grey + half, none), np.float32(255.0)))
    return ground


def _paint_start(track: Track, look: Look, grid: Grid, ground: Bytes) -> None:
    ends = _texels(np.stack([track.inner[0], track.outer[0]]), grid)
    width = float(np.hypot(*(ends[1] - ends[0])))
    if width == 0.0:
        return
    across = (ends[1] - ends[0]) / width
    half_depth = 0.5 * look.start_depth_m / grid.texel_m
    inset = look.border_width_m / grid.texel_m if look.border_side == "in" else 0.0
    low = np.maximum(np.floor(ends.min(axis=0) - half_depth - 1.0).astype(int), 0)
    high = np.ceil(ends.max(axis=0) + half_depth + 2.0).astype(int)
    window = ground[low[1] : high[1], low[0] : high[0]]

    fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    y = low[1] + np.add.outer(np.arange(window.shape[0]), fine)[:, None, :, None] - ends[0, 1]
    x = low[0] + np.add.outer(np.arange(window.shape[1]), fine)[None, :, None, :] - ends[0, 0]
    over = (x * across[0] + y * across[1] - inset) / (width - 2.0 * inset)
    along = (y * across[0] - x * across[1] + half_depth) / (2.0 * half_depth)
    within = (over >= 0.0) & (over < 1.0) & (along >= 0.0) & (along < 1.0)
    squares = np.floor(over * look.start_squares[0]) + np.floor(along * look.start_squares[1])
    shade = np.where(squares % 2 == 0, look.line.grey, look.chequer.grey)
    cover = within.mean(axis=(2, 3))
    seen = (within * shade).mean(axis=(2, 3)) + (1.0 - cover) * window
    window[:] = np.rint(seen).astype(np.uint8)


def _grain_tile(world: str, texel_m: float) -> Singles:
    random = np.random.default_rng(zlib.crc32(world.encode()))
    count = _TILE * _TILE // 8
    fibres = random.random((count, 3))
    shades = random.standard_normal(count)
    tile = np.zeros((_TILE, _TILE))
    _strew(fibres, shades, _STROKE_M / texel_m, tile)
    return np.asarray(((tile - tile.mean()) / tile.std()).astype(np.float32))


@kernel
def _strew(fibres: Floats, shades: Floats, length: float, tile: Floats) -> None:
    side = tile.shape[0]
    dots = math.ceil(2.0 * length) + 1
    for i in range(len(fibres)):
        angle = 2.0 * math.pi * fibres[i, 2]
        for dot in range(dots):
            out = length * (dot / (dots - 1.0) - 0.5)
            x = fibres[i, 0] * side + out * math.cos(angle)
            y = fibres[i, 1] * side + out * math.sin(angle)
            column, row = math.floor(x), math.floor(y)
            right, up = x - column, y - row
            tile[row % side, column % side] += shades[i] * (1.0 - right) * (1.0 - up)
            tile[row % side, (column + 1) % side] += shades[i] * right * (1.0 - up)
            tile[(row + 1) % side, column % side] += shades[i] * (1.0 - right) * up
            tile[(row + 1) % side, (column + 1) % side] += shades[i] * right * up

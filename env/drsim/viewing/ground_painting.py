"""Paints the ground in the view of the world: field, road, lines, kerbs, dashes, start line."""

import math
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import RGB, Floats, Singles
from drsim.jit import kernel
from drsim.track.polyline import without_repeats
from drsim.track.road_cells import sign_off_road
from drsim.track.track import Track

Corners = tuple[float, float, float, float]

_DOT_M = 0.004
_MOWN_M = 0.9


class Ground(NamedTuple):
    """What `drsim.viewing.ground_painting` measured, and the grain.

    Attributes:
        grain: Copies of a tile, each with half the dots along its sides. Shape (k, n, n).
    """

    cells: Singles
    x_m: float
    y_m: float
    cell_m: float
    grain: Singles


class Marks(NamedTuple):
    """What is painted on the ground; metres.

    Attributes:
        line: From the border, positive on the road.
        dash: Width, length, pitch, and first start.
        start: Middle (x, y), direction across the road (x, y), length and depth.
        squares: Across and along.
    """

    line: tuple[float, float]
    kerb_m: float
    stripe_m: float
    dash: tuple[float, float, float, float]
    start: tuple[float, float, float, float, float, float]
    squares: tuple[float, float]


class Palette(NamedTuple):
    """Red, green and blue, 0 to 255 each."""

    road: RGB
    line: RGB
    dash: RGB
    kerb: RGB
    kerb_light: RGB
    field: RGB
    chequer: RGB
    haze: RGB


@kernel
def paint_ground(
    ground_parts: tuple[Any, ...],
    marks_parts: tuple[Any, ...],
    palette_parts: tuple[Any, ...],
    lens_parts: tuple[Any, ...],
    row_parts: tuple[Floats, Floats, Floats],
    haze_m: float,
    light: Singles,
    mixed: Singles,
) -> None:
    """Lay the ground over rows of a picture, `mixed`, which hold what lies behind it."""
    ground, marks, palette = Ground(*ground_parts), Marks(*marks_parts), Palette(*palette_parts)
    pos, _, to_left, to_up, focal_px = lens_parts
    directions, depths, belows = row_parts
    step = (-to_left[0] / focal_px, -to_left[1] / focal_px)
    for row in range(len(mixed)):
        below, depth = belows[row], depths[row]
        if below <= 0.0:
            continue
        ahead = (directions[row, 0], directions[row, 1], directions[row, 2])
        at = (
            (pos[0] + depth * ahead[0], pos[1] + depth * ahead[1]),
            (depth * step[0], depth * step[1]),
        )
        lean = depth / -min(ahead[2], -0.4 / focal_px) / focal_px
        down = (-to_up[0] * depth / focal_px, -to_up[1] * depth / focal_px, -to_up[2] * lean)
        view = (ahead, step, depth, below)
        _ground_row(ground, marks, palette, view, at, down, haze_m, light[row], mixed[row])


@kernel
def _ground_row(
    ground: Ground,
    marks: Marks,
    palette: Palette,
    view: tuple[RGB, tuple[float, float], float, float],
    at: tuple[tuple[float, float], tuple[float, float]],
    fall: RGB,
    haze_m: float,
    light: Singles,
    mixed: Singles,
) -> None:
    """`fall` is the change of `at` from row to row."""
    # Taken out of the records once: each access in the loop would count references.
    cells, grain = ground.cells, ground.grain
    corner_x, corner_y, cell_m = ground.x_m, ground.y_m, ground.cell_m
    rows, columns, _ = cells.shape
    begin, end = marks.line
    kerb_m, stripe_m = marks.kerb_m, marks.stripe_m
    width, length, pitch, begins = marks.dash
    ahead, step, depth, below = view
    (first_x, first_y), right = at
    level = _grain_level(len(grain), math.hypot(right[0], right[1]))
    dots = 1.0 / (_DOT_M * (1 << level))
    mask = np.uint32((grain.shape[1] >> level) - 1)
    one = np.uint32(1)
    for pixel in range(len(mixed)):
        x, y = first_x + pixel * right[0], first_y + pixel * right[1]
        to_x, to_y = ahead[0] + pixel * step[0], ahead[1] + pixel * step[1]
        down = (fall[0] + fall[2] * to_x, fall[1] + fall[2] * to_y)

        # The grain, between four dots of the copy that fits the size of a pixel.
        dot_x, dot_y = x * dots + 1048576.0, y * dots + 1048576.0
        whole_x, whole_y = np.uint32(dot_x), np.uint32(dot_y)
        dot_part_x, dot_part_y = dot_x - whole_x, dot_y - whole_y
        dot_left, dot_low = whole_x & mask, whole_y & mask
        dot_right, dot_high = (whole_x + one) & mask, (whole_y + one) & mask
        low = grain[level, dot_low, dot_left]
        low += dot_part_x * (grain[level, dot_low, dot_right] - low)
        high = grain[level, dot_high, dot_left]
        high += dot_part_x * (grain[level, dot_high, dot_right] - high)
        rough = low + dot_part_y * (high - low)

        blur = abs(right[0] + right[1] + down[0] + down[1]) * (0.7071 / (2.0 * _MOWN_M))
        bright = 1.0 + 0.035 * _wave((x + y) * (0.7071 / (2.0 * _MOWN_M)), blur) + 0.055 * rough
        color = _scaled(palette.field, bright)

        across, along = (x - corner_x) / cell_m, (y - corner_y) / cell_m
        if 0.0 <= across < columns - 1.001 and 0.0 <= along < rows - 1.001:
            column, row = int(across), int(along)
            part = across - column, along - row
            side, side_x, side_y = _level(_cell(cells, row, column, 0), part, cell_m)
            blur = _length(side_x, side_y, right, down)
            past_begin, past_end = _share(side - begin, blur), _share(side - end, blur)
            if past_begin < 1.0 and side > begin - kerb_m - blur:
                whole, _, _ = _level(_cell(cells, row, column, 1), part, cell_m)
                past_kerb = _share(side - begin + kerb_m * min(1.0, 3.0 * whole), blur)
                if past_kerb > 0.0 and whole > 0.02:
                    place = _place(_cell(cells, row, column, 2), part)
                    run = _length(-side_y, side_x, right, down) / (2.0 * stripe_m)
                    stripe = 0.5 + 0.5 * _wave(place / (2.0 * stripe_m), run)
                    kerb = _mixed(palette.kerb, palette.kerb_light, stripe)
                    color = _mixed(color, kerb, past_kerb * (1.0 + 0.03 * rough))
            if past_begin > 0.0 and past_end < 1.0:
                color = _mixed(color, _scaled(palette.line, 1.0 + 0.02 * rough), past_begin)
            if past_end > 0.0:
                away, away_x, away_y = _level(_cell(cells, row, column, 3), part, cell_m)
                # Tyres polish the middle of the road.
                beside = (away - 0.10) * 8.0
                worn = (1.0 - 0.10 / (1.0 + beside * beside)) * (1.0 + 0.10 * rough)
                color = _mixed(color, _scaled(palette.road, worn), past_end)
                if away < 0.5:
                    blur = _length(away_x, away_y, right, down)
                    cover = _share(away + 0.5 * width, blur) - _share(away - 0.5 * width, blur)
                    if cover > 0.0 and pitch > 0.0:
                        place = _place(_cell(cells, row, column, 4), part)
                        run = _length(-away_y, away_x, right, down) / pitch
                        cover *= _dashed((place - begins) / pitch, length / pitch, run)
                        color = _mixed(color, palette.dash, cover)
                color = _start(marks, palette, (x, y), right, down, color)
        far = depth * math.sqrt(to_x * to_x + to_y * to_y) / haze_m
        clear = 1.0 / (1.0 + far + 0.5 * far * far)
        color = _mixed(palette.haze, _scaled(color, light[pixel]), clear)
        for channel in range(3):
            mixed[pixel, channel] += below * (color[channel] - mixed[pixel, channel])


@kernel
def _scaled(color: RGB, factor: float) -> RGB:
    return color[0] * factor, color[1] * factor, color[2] * factor


@kernel
def _mixed(under: RGB, over: RGB, share: float) -> RGB:
    return (
        under[0] + share * (over[0] - under[0]),
        under[1] + share * (over[1] - under[1]),
        under[2] + share * (over[2] - under[2]),
    )


@kernel
def _cell(cells: Singles, row: int, column: int, what: int) -> Corners:
    return (
        cells[row, column, what],
        cells[row, column + 1, what],
        cells[row + 1, column, what],
        cells[row + 1, column + 1, what],
    )


@kernel
def _level(corners: Corners, part: tuple[float, float], cell_m: float) -> RGB:
    """A value between corners of a cell, and its slopes."""
    a, b, c, d = corners
    low, high = a + part[0] * (b - a), c + part[0] * (d - c)
    steep = (b - a) + part[1] * ((d - c) - (b - a))
    return low + part[1] * (high - low), steep / cell_m, (high - low) / cell_m


@kernel
def _start(
    marks: Marks,
    palette: Palette,
    hit: tuple[float, float],
    right: tuple[float, float],
    down: tuple[float, float],
    under: RGB,
) -> RGB:
    middle_x, middle_y, to_x, to_y, length_m, depth_m = marks.start
    if depth_m <= 0.0:
        return under
    x, y = hit[0] - middle_x, hit[1] - middle_y
    over, along = x * to_x + y * to_y, y * to_x - x * to_y
    if abs(over) > length_m or abs(along) > depth_m + 1.0:
        return under
    wide, deep = _length(to_x, to_y, right, down), _length(-to_y, to_x, right, down)
    cover = _share(over + 0.5 * length_m, wide) - _share(over - 0.5 * length_m, wide)
    cover *= _share(along + 0.5 * depth_m, deep) - _share(along - 0.5 * depth_m, deep)
    if cover <= 0.0:
        return under
    squares_over, squares_along = marks.squares
    pair_m, pair_along_m = 2.0 * length_m / squares_over, 2.0 * depth_m / squares_along
    first = _wave((over + 0.5 * length_m) / pair_m, wide / pair_m)
    second = _wave((along + 0.5 * depth_m) / pair_along_m, deep / pair_along_m)
    light = 0.5 + 0.5 * first * second
    return _mixed(under, _mixed(palette.chequer, palette.line, light), cover)


@kernel
def _place(corners: Corners, part: tuple[float, float]) -> float:
    """As `_level`, but nothing between the two ends of a line."""
    a, b, c, d = corners
    if max(a, b, c, d) - min(a, b, c, d) > 0.3:
        if part[1] < 0.5:
            return a if part[0] < 0.5 else b
        return c if part[0] < 0.5 else d
    low, high = a + part[0] * (b - a), c + part[0] * (d - c)
    return low + part[1] * (high - low)


@kernel
def _length(x: float, y: float, right: tuple[float, float], down: tuple[float, float]) -> float:
    first, second = x * right[0] + y * right[1], x * down[0] + y * down[1]
    return math.sqrt(first * first + second * second) + 1e-6


@kernel
def _share(beyond: float, blur: float) -> float:
    return min(max(0.5 + beyond / blur, 0.0), 1.0)


@kernel
def _wave(place: float, blur: float) -> float:
    if blur >= 1.0:
        return 0.0
    part = place - math.floor(place)
    away = min(part, 1.0 - part) if part < 0.25 or part > 0.75 else abs(part - 0.5)
    sign = 1.0 if part < 0.5 else -1.0
    sharp = min(2.0 * away / max(blur, 1e-6), 1.0)
    return sign * sharp * min(1.0, 2.0 - 2.0 * blur)


@kernel
def _dashed(place: float, length: float, blur: float) -> float:
    if blur >= 1.0:
        return length
    part = place - math.floor(place)
    within = max(min(part, length - part), part - 1.0)
    sharp = min(max(0.5 + within / max(blur, 1e-6), 0.0), 1.0)
    calm = max(0.0, 2.0 * blur - 1.0)
    return sharp + calm * (length - sharp)


@kernel
def _grain_level(copies: int, pixel_m: float) -> int:
    level = math.floor(math.log2(max(pixel_m, 1e-9) / _DOT_M) + 0.5)
    return min(max(int(level), 0), copies - 1)


# Distances on the ground of a track, on a coarse grid, for edges that are sharp in any picture.


CELL_M = 0.02
MOST_CELLS = 3_000_000
"""60 MB."""

REACH_M = 0.6
SIDE, CENTRE = 0, 3
"""Of the five numbers of a cell, in metres: distance to the nearest border, positive on the road;
share of a kerb there; distance along the border; distance to and along the centre line.
"""

KERB_RADIUS_M = (1.6, 3.0)
"""Of bends with a whole kerb, and without."""

_BEND_M = 0.5
"""Border that a bend is measured on, to both sides."""


def measure_ground(track: Track, *, everywhere: bool) -> tuple[Singles, float, float, float]:
    """The first parts of `Ground`, in 0.1 to 0.4 s; with kerbs at bends or `everywhere`."""
    center = without_repeats(track.center[::-1] if track.reverse else track.center)
    inner, outer = (
        without_repeats(line[::-1] if track.reverse else line)
        for line in (track.inner, track.outer)
    )
    border = np.concatenate([inner, outer])
    low, high = border.min(axis=0) - REACH_M, border.max(axis=0) + REACH_M
    cell_m = max(CELL_M, math.sqrt(float((high - low).prod()) / MOST_CELLS))
    columns, rows = (np.ceil((high - low) / cell_m).astype(int) + 1).tolist()

    cells = np.zeros((rows, columns, 5), np.float32)
    cells[:, :, SIDE] = cells[:, :, CENTRE] = REACH_M
    for line in (inner, outer):
        kerbs = np.ones(len(line)) if everywhere else kerbs_of(line, track.closed)
        _stamp(line - low, kerbs, track.closed, cell_m, SIDE, cells)
    _stamp(center - low, np.zeros(len(center)), track.closed, cell_m, CENTRE, cells)
    borders = [np.ascontiguousarray((line - low) / cell_m) for line in (inner, outer)]
    sign_off_road(borders[0], borders[1], track.closed, cells[:, :, SIDE])
    return cells, float(low[0]), float(low[1]), cell_m


def kerbs_of(line: Floats, closed: bool) -> Floats:
    steps = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    length = float(along[-1])

    def at(distance_m: Floats) -> Floats:
        where = distance_m % length if closed else np.clip(distance_m, 0.0, length)
        return np.stack([np.interp(where, along, line[:, k]) for k in range(2)], axis=1)

    here = at(along)
    ahead, behind = at(along + _BEND_M) - here, here - at(along - _BEND_M)
    turn = np.arctan2(
        behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0], (behind * ahead).sum(axis=1)
    )
    least, most = KERB_RADIUS_M
    bend = np.abs(turn) / _BEND_M
    return np.asarray(np.clip((bend - 1.0 / most) / (1.0 / least - 1.0 / most), 0.0, 1.0))


@kernel
def _stamp(
    line: Floats, kerbs: Floats, closed: bool, cell_m: float, first: int, cells: Singles
) -> None:
    rows, columns, _ = cells.shape
    last = len(line) - 1
    passed = 0.0
    for i in range(1, len(line)):
        ax, ay = line[i - 1]
        dx, dy = line[i, 0] - ax, line[i, 1] - ay
        square = max(dx * dx + dy * dy, 1e-12)
        step = math.sqrt(square)
        top = max(math.ceil((min(ay, ay + dy) - 0.6) / cell_m), 0)
        bottom = min(math.floor((max(ay, ay + dy) + 0.6) / cell_m) + 1, rows)
        left = max(math.ceil((min(ax, ax + dx) - 0.6) / cell_m), 0)
        right = min(math.floor((max(ax, ax + dx) + 0.6) / cell_m) + 1, columns)
        for row in range(top, bottom):
            for column in range(left, right):
                px, py = column * cell_m - ax, row * cell_m - ay
                along = (px * dx + py * dy) / square
                if not closed and ((i == 1 and along < 0.0) or (i == last and along > 1.0)):
                    continue
                along = min(max(along, 0.0), 1.0)
                away = math.hypot(px - along * dx, py - along * dy)
                if away < cells[row, column, first]:
                    cells[row, column, first] = away
                    if first == 0:
                        cells[row, column, 1] = kerbs[i - 1] + along * (kerbs[i] - kerbs[i - 1])
                        cells[row, column, 2] = passed + along * step
                    else:
                        cells[row, column, 4] = passed + along * step
        passed += step

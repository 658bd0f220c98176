"""The camera's inner loops: sky and walls, then the ground, ray by ray.

The reference simulator shrinks 640 x 480 to 160 x 120 with a tent filter, two output pixels wide:
here sideways by the choice of the ground picture's copy, downwards by several sample lines.

Loops that call each other stay in one file: numba's cache does not notice changes of another.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import Bytes, Floats, Ints, Ints32, Single, Singles, Vector, Words
from drsim.jit import kernel, prefetch, take_number

_SHARPNESS = 1.0
"""Of a texel over a pixel. 0.82 has the variance of the tent filter; 1.0 looks the same and reads
less memory.
"""

_LINE_GAP = 2.2
"""In texels. 1.6 takes 30 % longer and brings the mean difference from 0.7 to 0.6 greys."""

MOST_LINES = 2
"""Near the horizon coarser texels take over."""

EDGE_BLUR = 1.4
"""Bytes; such a box has the tent filter's variance."""

LEAST_FALL = 0.004
"""Per unit of depth: ground beyond 33 m looks alike."""

FURTHEST = 1e9
"""256ths of a texel must fit 32 bits."""

_NO_PALETTE = np.empty(0, np.uint8)


class Ground(NamedTuple):
    """As in `scene.Scene`."""

    texels: Words
    levels: Ints32
    x_m: float
    y_m: float
    texel_m: float


class Backdrop(NamedTuple):
    """Walls and sky, and what becomes of the greys of the ground, for n lenses or for all.

    Attributes:
        walls_m: Inner faces: least x, greatest x, least y, greatest y.
        palettes: (0, 256) where greys stay, or (n, 256).
    """

    walls_m: Singles
    wall_height_m: float
    wall_greys: Singles
    sky_greys: Singles
    palettes: Bytes


class Lenses(NamedTuple):
    """The lenses of n cars.

    Attributes:
        mat: Columns forward, left, up. Shape (n, 3, 3).
        bias: Added to a grey before its fraction is cut off.
    """

    pos: Floats
    mat: Floats
    focal_px: float
    bias: float


class Lens(NamedTuple):
    """Numbers, not arrays: the compiler counts references to each array of a call."""

    pos: Vector
    forward: Vector
    left: Vector
    up: Vector
    focal_px: float


@kernel
def draw(
    ground_parts: tuple[Any, ...],
    backdrop_parts: tuple[Any, ...],
    lens_parts: tuple[Any, ...],
    out: Bytes,
    wanted: Ints,
    taken: Ints,
) -> None:
    """Draw the `wanted` lenses' frames; threads share the counter `taken`, and so the work."""
    ground, backdrop = Ground(*ground_parts), Backdrop(*backdrop_parts)
    lenses = Lenses(*lens_parts)
    _, rows, columns = out.shape
    behind = np.empty((rows, columns), np.float32)
    share = np.empty((rows, columns), np.float32)
    wall_greys, sky_greys = backdrop.wall_greys, backdrop.sky_greys
    while True:
        number = take_number(taken)
        if number >= len(wanted):
            break
        car = wanted[number]
        frame = out[car]
        pos, mat = lenses.pos[car], lenses.mat[car]
        if not math.isfinite(pos.sum() + mat.sum()):
            frame[:] = 0
            continue
        lens = Lens(
            (pos[0], pos[1], pos[2]),
            (mat[0, 0], mat[1, 0], mat[2, 0]),
            (mat[0, 1], mat[1, 1], mat[2, 1]),
            (mat[0, 2], mat[1, 2], mat[2, 2]),
            lenses.focal_px,
        )
        greys, sky_grey = wall_greys[car % len(wall_greys)], sky_greys[car % len(sky_greys)]
        first, clear = _backdrop(backdrop, greys, sky_grey, lens, behind, share)
        for row in range(first):
            _store(behind[row], lenses.bias, frame[row])
        if first < rows:
            palette = backdrop.palettes[car] if len(backdrop.palettes) > 0 else _NO_PALETTE
            beyond = _Beyond(behind, share, first, clear)
            _floor(ground, palette, lens, beyond, lenses.bias, frame)


class _Beyond(NamedTuple):
    """`first` row shows any ground, `clear` nothing else."""

    behind: Singles
    share: Singles
    first: int
    clear: int


@kernel
def _backdrop(
    backdrop: Backdrop,
    greys: Singles,
    sky_grey: Single,
    lens: Lens,
    behind: Singles,
    share: Singles,
) -> tuple[int, int]:
    rows, columns = behind.shape
    pos, walls_m, focal_px = lens.pos, backdrop.walls_m, lens.focal_px
    inside = walls_m[0] < pos[0] < walls_m[1] and walls_m[2] < pos[1] < walls_m[3]
    upright = lens.up[2] > 0.5
    near = (
        nearness(walls_m[0] - pos[0]),
        nearness(walls_m[1] - pos[0]),
        nearness(walls_m[2] - pos[1]),
        nearness(walls_m[3] - pos[1]),
    )
    edges = Single(pos[2]), Single(pos[2] - backdrop.wall_height_m), Single(focal_px / EDGE_BLUR)
    first = rows
    for row in range(rows):
        ahead, step = ray_through(lens, row + 0.5, rows, columns)
        _backdrop_row(near, edges, greys, sky_grey, ahead, step, behind[row], share[row])
        if first == rows and min(ahead[2], ahead[2] + columns * step[2]) < 1.0 / focal_px:
            for column in range(columns):
                if share[row, column] > 0.0:
                    first = row
                    break
        # The floor is convex and so is its image: a row with both ends on the floor lies on it.
        if inside and upright and share[row, 0] >= 1.0 and share[row, -1] >= 1.0:
            return min(first, row), row
    return first, rows


@kernel
def ray_through(lens: Lens, height_px: float, rows: int, columns: int) -> tuple[Vector, Vector]:
    """World direction, of depth 1, of the leftmost pixel, and its change per column."""
    forward, to_left, to_up, focal_px = lens.forward, lens.left, lens.up, lens.focal_px
    left = (0.5 * columns - 0.5) / focal_px
    up = (0.5 * rows - height_px) / focal_px
    return (
        (
            forward[0] + left * to_left[0] + up * to_up[0],
            forward[1] + left * to_left[1] + up * to_up[1],
            forward[2] + left * to_left[2] + up * to_up[2],
        ),
        (-to_left[0] / focal_px, -to_left[1] / focal_px, -to_left[2] / focal_px),
    )


@kernel
def nearness(distance_m: float) -> Single:
    return Single(1.0 / distance_m) if abs(distance_m) > 1e-6 else Single(1e6)


@kernel
def _backdrop_row(
    near: tuple[Single, Single, Single, Single],
    edges: tuple[Single, Single, Single],
    wall_greys: Singles,
    sky_grey: Single,
    ahead: Vector,
    step: Vector,
    behind: Singles,
    share: Singles,
) -> None:
    """With one over signed distances of walls, so without division."""
    zero, half, one = Single(0.0), Single(0.5), Single(1.0)
    ahead_x, ahead_y, ahead_z = Single(ahead[0]), Single(ahead[1]), Single(ahead[2])
    step_x, step_y, step_z = Single(step[0]), Single(step[1]), Single(step[2])
    grey_low_x, grey_high_x = wall_greys[0], wall_greys[1]
    grey_low_y, grey_high_y = wall_greys[2], wall_greys[3]
    near_low_x, near_high_x, near_low_y, near_high_y = near
    over_floor, over_walls, sharpness = edges
    for column in range(len(behind)):
        # By way of 32 bits: numba counts in 64, which few processors turn into floats by vectors.
        c = Single(np.int32(column))
        x, y, z = ahead_x + c * step_x, ahead_y + c * step_y, ahead_z + c * step_z
        near_x = x * (near_high_x if x > zero else near_low_x)
        near_y = y * (near_high_y if y > zero else near_low_y)
        grey_x = grey_high_x if x > zero else grey_low_x
        grey_y = grey_high_y if y > zero else grey_low_y
        grey = grey_x if near_x > near_y else grey_y
        nearest = max(near_x, near_y, zero)
        sky = min(max(half + (over_walls * nearest + z) * sharpness, zero), one)
        behind[column] = grey + sky * (sky_grey - grey)
        share[column] = min(max(half - (over_floor * nearest + z) * sharpness, zero), one)


@kernel
def _floor(
    ground: Ground, palette: Bytes, lens: Lens, beyond: _Beyond, bias: float, frame: Bytes
) -> None:
    pos, first, clear = lens.pos, beyond.first, beyond.clear
    # Taken out of the records once: each access in a loop would count references.
    texels, levels, behind, share = ground.texels, ground.levels, beyond.behind, beyond.share
    corner_x_m, corner_y_m, finest_m = ground.x_m, ground.y_m, ground.texel_m
    rows, columns = frame.shape
    at = np.empty((2, MOST_LINES, columns), np.int32)
    between = np.empty((2, MOST_LINES, columns), np.int32)
    words = np.empty(columns, np.uint32)
    sums = np.zeros((2, columns), np.float32)
    lens_height_m = min(max(pos[2], 1e-3), 10.0)
    lines = 0
    for aimed in range(first - 1, rows + 1):
        # Sample lines lie between the centres of a row and the next. Each counts for both, by
        # nearness: that is the tent filter.
        lines_above = lines
        if aimed < rows:
            index, lines = sampling(lens, aimed + 1.0, rows, lens_height_m, finest_m, len(levels))
            texel_m = finest_m * (1 << index)
            x = 256.0 * ((pos[0] - corner_x_m) / texel_m - 0.5)
            y = 256.0 * ((pos[1] - corner_y_m) / texel_m - 0.5)
            for line in range(lines):
                ahead, step = ray_through(lens, aimed + 0.5 + (line + 0.5) / lines, rows, columns)
                _aim(
                    Single(min(max(x, -FURTHEST), FURTHEST)),
                    Single(min(max(y, -FURTHEST), FURTHEST)),
                    Single(-256.0 * lens_height_m / texel_m),
                    ahead,
                    step,
                    levels[index],
                    at[aimed & 1, line],
                    between[aimed & 1, line],
                )
                _order(texels, at[aimed & 1, line])
        row = aimed - 1
        if row < first - 1:
            continue
        here, below = sums[row & 1], sums[aimed & 1]
        below[:] = Single(0.0)
        for line in range(lines_above):
            _fetch(texels, at[row & 1, line], words)
            if len(palette) > 0:
                _recolour(words, palette)
            part = (line + 0.5) / lines_above
            weight = 1.0 / (65536.0 * lines_above)
            _blend(
                words,
                between[row & 1, line],
                Single(weight - part * weight),
                Single(part * weight),
                here,
                below,
            )
        if row >= clear:
            _store(here, bias, frame[row])
        elif row >= first:
            _store_before(here, behind[row], share[row], bias, frame[row])


@kernel
def sampling(
    lens: Lens, height_px: float, rows: int, lens_height_m: float, texel_m: float, copies: int
) -> tuple[int, int]:
    """Copy of the ground picture and number of sample lines."""
    forward, to_up = lens.forward, lens.up
    up = (0.5 * rows - height_px) / lens.focal_px
    x, y = forward[0] + up * to_up[0], forward[1] + up * to_up[1]
    fall = max(-(forward[2] + up * to_up[2]), LEAST_FALL)
    across_m = lens_height_m / fall / lens.focal_px
    lean = to_up[2] / fall
    down_x, down_y = to_up[0] + lean * x, to_up[1] + lean * y
    down_m = across_m * math.sqrt(down_x * down_x + down_y * down_y)
    wanted_m = max(_SHARPNESS * across_m, down_m / (_LINE_GAP * MOST_LINES))
    # The nearest power of two, without a logarithm: most rows see one of the first copies.
    index, next_m = 0, math.sqrt(2.0) * texel_m
    while index < copies - 1 and wanted_m >= next_m:
        index, next_m = index + 1, 2.0 * next_m
    lines = math.ceil(down_m / (_LINE_GAP * texel_m * (1 << index)))
    return index, min(max(lines, 1), MOST_LINES)


@kernel
def _aim(
    origin_x: Single,
    origin_y: Single,
    to_texels: Single,
    ahead: Vector,
    step: Vector,
    level: Ints32,
    at: Ints32,
    between: Ints32,
) -> None:
    """Apart from `_fetch` and `_blend`: its scattered reads would prevent vector instructions."""
    first, pitch = level[0], level[1]
    zero, least = np.int32(0), Single(-LEAST_FALL)
    last_x, last_y = np.int32(256 * (level[2] - 1)), np.int32(256 * (level[3] - 1))
    ahead_x, step_x = to_texels * Single(ahead[0]), to_texels * Single(step[0])
    ahead_y, step_y = to_texels * Single(ahead[1]), to_texels * Single(step[1])
    ahead_z, step_z = Single(ahead[2]), Single(step[2])
    for column in range(len(at)):
        c = Single(np.int32(column))
        # Not `/`, whose test for zero would keep this loop from becoming vector instructions.
        depth = np.divide(Single(1.0), min(ahead_z + c * step_z, least))
        x = min(max(np.int32(origin_x + depth * (ahead_x + c * step_x)), zero), last_x)
        y = min(max(np.int32(origin_y + depth * (ahead_y + c * step_y)), zero), last_y)
        at[column] = first + (y >> np.int32(8)) * pitch + (x >> np.int32(8))
        between[column] = (x & np.int32(255)) << np.int32(8) | y & np.int32(255)


@kernel
def _order(texels: Words, at: Ints32) -> None:
    for column in range(0, len(at), 4):
        prefetch(texels, np.uint32(at[column]))


@kernel
def _fetch(texels: Words, at: Ints32, words: Words) -> None:
    for column in range(len(at)):
        words[column] = texels[np.uint32(at[column])]


@kernel
def _recolour(words: Words, palette: Bytes) -> None:
    byte = np.uint32(255)
    for column in range(len(words)):
        word = words[column]
        words[column] = (
            np.uint32(palette[word & byte])
            | np.uint32(palette[word >> np.uint32(8) & byte]) << np.uint32(8)
            | np.uint32(palette[word >> np.uint32(16) & byte]) << np.uint32(16)
            | np.uint32(palette[word >> np.uint32(24)]) << np.uint32(24)
        )


@kernel
def _blend(
    words: Words,
    between: Ints32,
    weight_here: Single,
    weight_below: Single,
    here: Singles,
    below: Singles,
) -> None:
    whole, pair, low = np.uint32(256), np.uint32(0x00FF00FF), np.uint32(0xFFFF)
    for column in range(len(words)):
        word = words[column]
        right = np.uint32(between[column] >> np.int32(8))
        up = np.uint32(between[column] & np.int32(255))
        # Two products at once: the left texels in the low half, the right ones in the high half.
        mixed = (word & pair) * (whole - up) + (word >> np.uint32(8) & pair) * up
        blend = (mixed & low) * (whole - right) + (mixed >> np.uint32(16)) * right
        grey = Single(np.int32(blend))
        here[column] += weight_here * grey
        below[column] += weight_below * grey


@kernel
def _store(greys: Singles, bias: float, pixels: Bytes) -> None:
    more = Single(bias)
    for column in range(len(pixels)):
        pixels[column] = np.uint8(np.int32(greys[column] + more))


@kernel
def _store_before(
    greys: Singles, behind: Singles, share: Singles, bias: float, pixels: Bytes
) -> None:
    more = Single(bias)
    for column in range(len(pixels)):
        grey = behind[column] + share[column] * (greys[column] - behind[column])
        pixels[column] = np.uint8(np.int32(grey + more))

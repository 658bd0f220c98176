"""Draws cuboids over frames, with edges blurred by a tent filter.

All loops that call each other stay in this one file, as in `drsim.sensing.raycast`.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import Bytes, Cuboids, Floats, Ints, Single, Singles, Vector
from drsim.jit import kernel

TO_SUN = (0.48337, -0.09667, 0.87006)
"""Source: the reference simulator's worlds, 121 of which share a sun that shines towards -0.5,
0.1, -0.9.
"""

_NEAR_M = 0.02
"""Source: the reference simulator's camera."""

_LINES = 8
_STEEP = 2.0
_TOUCH_M = 1e-4
_SIDES = 5


class _Lens(NamedTuple):
    pos: Vector
    forward: Vector
    left: Vector
    up: Vector
    focal_px: float


class _Images(NamedTuple):
    """Of m cuboids in one frame; `corners` is 0 where a side cannot be seen."""

    outlines: Floats
    corners: Ints
    greys: Floats
    windows: Ints


@kernel
def draw(boxes: Cuboids, light: Singles, lens_parts: tuple[Any, ...], out: Bytes) -> None:
    """Draw the cuboids that each lens sees; arguments as in `camera.render`.

    `light` holds weights of red, green and blue, on every side, then in the sun. Shape (n, 6).
    """
    lens_pos, lens_mat, focal_px, bias = lens_parts
    cars, rows, columns = out.shape
    count = boxes.shape[1]
    images = _Images(
        np.empty((count, _SIDES, 5, 2)),
        np.empty((count, _SIDES), np.int64),
        np.empty((count, _SIDES)),
        np.empty((count, 4), np.int64),
    )
    order = np.empty(count, np.int64)
    steps = np.zeros((2, columns), np.float32)
    for car in range(cars):
        pos, mat = lens_pos[car], lens_mat[car]
        if not math.isfinite(pos.sum() + mat.sum()):
            continue
        lens = _Lens(
            (pos[0], pos[1], pos[2]),
            (mat[0, 0], mat[1, 0], mat[2, 0]),
            (mat[0, 1], mat[1, 1], mat[2, 1]),
            (mat[0, 2], mat[1, 2], mat[2, 2]),
            focal_px,
        )
        seen = 0
        for k in range(count):
            box = boxes[car, k]
            if not _reaches_before(box, lens):
                continue
            outlines, corners, greys = images.outlines[k], images.corners[k], images.greys[k]
            for side in range(_SIDES):
                corners[side], greys[side] = _side(
                    box, side, light[car], lens, (rows, columns), outlines[side]
                )
            window = images.windows[k]
            _frame_in(outlines, corners, rows, columns, window)
            if window[0] < window[1] and window[2] < window[3]:
                order[seen] = k
                seen += 1
        if seen > 1:
            _sort(boxes[car], images.windows, lens.pos, order[:seen])
        for k in order[:seen]:
            _paint(images, k, bias, steps, out[car])


@kernel
def _reaches_before(box: Any, lens: _Lens) -> bool:
    pos = lens.pos
    ahead_x, ahead_y, ahead_z = lens.forward
    depth_m = (
        (box.x - pos[0]) * ahead_x
        + (box.y - pos[1]) * ahead_y
        + (0.5 * (box.low + box.high) - pos[2]) * ahead_z
        + abs(box.cos * ahead_x + box.sin * ahead_y) * box.half_length
        + abs(box.cos * ahead_y - box.sin * ahead_x) * box.half_width
        + abs(ahead_z) * 0.5 * (box.high - box.low)
    )
    return bool(depth_m > _NEAR_M)


@kernel
def _side(
    box: Any, side: int, light: Singles, lens: _Lens, size_px: tuple[int, int], outline: Floats
) -> tuple[int, float]:
    pos, focal_px = lens.pos, lens.focal_px
    rows, columns = size_px
    cos, sin, half_x, half_y = box.cos, box.sin, box.half_length, box.half_width
    low, high = box.low, box.high
    # The middle of the side, from the lens, and half its edges: one level, one upright or level.
    to_x, to_y = box.x - pos[0], box.y - pos[1]
    if side == 4:
        if pos[2] <= high:
            return 0, 0.0
        to_z, lambert = high - pos[2], TO_SUN[2]
        first = (cos * half_x, sin * half_x, 0.0)
        second = (-sin * half_y, cos * half_y, 0.0)
    else:
        sign = 1.0 if side % 2 == 0 else -1.0
        if side < 2:
            normal_x, normal_y, out, half = sign * cos, sign * sin, half_x, half_y
        else:
            normal_x, normal_y, out, half = -sign * sin, sign * cos, half_y, half_x
        to_x, to_y = to_x + normal_x * out, to_y + normal_y * out
        if to_x * normal_x + to_y * normal_y >= 0.0:
            return 0, 0.0
        to_z, lambert = 0.5 * (low + high) - pos[2], 0.0
        lambert = max(normal_x * TO_SUN[0] + normal_y * TO_SUN[1], 0.0)
        first = (-normal_y * half, normal_x * half, 0.0)
        second = (0.0, 0.0, 0.5 * (high - low))
    middle = _in_lens(lens, (to_x, to_y, to_z))
    along, across = _in_lens(lens, first), _in_lens(lens, second)
    grey = 0.0
    for c in range(3):
        grey += box.color[c] * (light[c] + light[3 + c] * lambert)

    count = 0
    before_depth, before_left, before_up = _corner(3, middle, along, across)
    for corner in range(4):
        depth, left, up = _corner(corner, middle, along, across)
        if (depth >= _NEAR_M) != (before_depth >= _NEAR_M):
            part = (_NEAR_M - before_depth) / (depth - before_depth)
            scale = focal_px / _NEAR_M
            outline[count, 0] = 0.5 * columns - scale * (before_left + part * (left - before_left))
            outline[count, 1] = 0.5 * rows - scale * (before_up + part * (up - before_up))
            count += 1
        if depth >= _NEAR_M:
            scale = focal_px / depth
            outline[count, 0] = 0.5 * columns - scale * left
            outline[count, 1] = 0.5 * rows - scale * up
            count += 1
        before_depth, before_left, before_up = depth, left, up
    return count, min(grey, 255.0)


@kernel
def _in_lens(lens: _Lens, vector: Vector) -> Vector:
    x, y, z = vector
    ahead, left, up = lens.forward, lens.left, lens.up
    return (
        x * ahead[0] + y * ahead[1] + z * ahead[2],
        x * left[0] + y * left[1] + z * left[2],
        x * up[0] + y * up[1] + z * up[2],
    )


@kernel
def _corner(corner: int, middle: Vector, along: Vector, across: Vector) -> Vector:
    a = 1.0 if corner == 1 or corner == 2 else -1.0
    b = 1.0 if corner >= 2 else -1.0
    return (
        middle[0] + a * along[0] + b * across[0],
        middle[1] + a * along[1] + b * across[1],
        middle[2] + a * along[2] + b * across[2],
    )


@kernel
def _frame_in(outlines: Floats, corners: Ints, rows: int, columns: int, window: Ints) -> None:
    top, bottom, left, right = np.inf, -np.inf, np.inf, -np.inf
    for side in range(_SIDES):
        for corner in range(corners[side]):
            x, y = outlines[side, corner]
            left, right = min(left, x), max(right, x)
            top, bottom = min(top, y), max(bottom, y)
    window[:] = 0
    if top < bottom and top < rows + 1.0 and bottom > -1.0:
        window[0] = int(max(top - 0.5, 0.0))
        window[1] = int(min(bottom + 1.5, float(rows)))
    if left < right and left < columns + 1.0 and right > -1.0:
        window[2] = int(max(left - 2.5, 0.0))
        window[3] = int(min(right + 3.5, float(columns)))


@kernel
def _sort(boxes: Cuboids, windows: Ints, pos: Vector, order: Ints) -> None:
    count = len(order)
    away_m = np.empty(count)
    for i in range(count):
        away_m[i] = math.hypot(boxes[order[i]].x - pos[0], boxes[order[i]].y - pos[1])
    rest = order[np.argsort(-away_m)]
    hides = np.zeros((count, count), np.bool_)
    waits_for = np.zeros(count, np.int64)
    for i in range(count):
        for j in range(i):
            a, b = rest[i], rest[j]
            one, other = windows[a], windows[b]
            rows_overlap = max(one[0], other[0]) < min(one[1], other[1])
            if rows_overlap and max(one[2], other[2]) < min(one[3], other[3]):
                nearer = _nearer(boxes[a], boxes[b], pos)
                hides[i, j], hides[j, i] = nearer > 0, nearer < 0
                waits_for[i] += nearer > 0
                waits_for[j] += nearer < 0
    drawn = np.zeros(count, np.bool_)
    for place in range(count):
        following = -1
        for i in range(count):
            if not drawn[i] and (following < 0 or waits_for[i] == 0):
                following = i
                if waits_for[i] == 0:
                    break
        drawn[following] = True
        order[place] = rest[following]
        for i in range(count):
            waits_for[i] -= hides[i, following]


@kernel
def _nearer(a: Any, b: Any, pos: Vector) -> int:
    if b.low >= a.high - _TOUCH_M:
        return -1 if pos[2] > b.low else 1
    if a.low >= b.high - _TOUCH_M:
        return 1 if pos[2] > a.low else -1
    cos, sin = abs(a.cos * b.cos + a.sin * b.sin), abs(a.cos * b.sin - a.sin * b.cos)
    for owner in range(2):
        box, other = (a, b) if owner == 0 else (b, a)
        for axis in range(2):
            lengthwise = axis == 0
            x, y = (box.cos, box.sin) if lengthwise else (-box.sin, box.cos)
            half = box.half_length if lengthwise else box.half_width
            along = other.half_length if lengthwise else other.half_width
            across = other.half_width if lengthwise else other.half_length
            apart = x * (other.x - box.x) + y * (other.y - box.y)
            reach = cos * along + sin * across
            if abs(apart) >= half + reach - _TOUCH_M:
                to_lens = x * (pos[0] - box.x) + y * (pos[1] - box.y)
                beyond = to_lens * (1.0 if apart > 0.0 else -1.0) > half
                return -1 if beyond == (owner == 0) else 1
    return 0


@kernel
def _paint(images: _Images, k: int, bias: float, steps: Singles, frame: Bytes) -> None:
    first, last, left, right = images.windows[k]
    outlines, corners, greys = images.outlines[k], images.corners[k], images.greys[k]
    for row in range(first, last):
        for side in range(_SIDES):
            if corners[side] > 2:
                _add_row(outlines[side, : corners[side]], greys[side], row, left, right, steps)
        _cover(steps, left, right, bias, frame[row])


@kernel
def _add_row(outline: Floats, grey: float, row: int, low: int, high: int, steps: Singles) -> None:
    middle = row + 0.5
    top, bottom, has_corner = np.inf, -np.inf, False
    for corner in range(len(outline)):
        y = outline[corner, 1]
        top, bottom = min(top, y), max(bottom, y)
        has_corner |= abs(y - middle) < 1.0
    if bottom <= middle - 1.0 or top >= middle + 1.0:
        return
    if not has_corner:
        left, right, left_slope, right_slope = _span(outline, middle)
        if max(abs(left_slope), abs(right_slope)) < _STEEP:
            # A slope blurs an edge; a tent of the same variance is that much wider.
            _add_edge(left, math.sqrt(1.0 + left_slope**2), 1.0, grey, low, high, steps)
            _add_edge(right, math.sqrt(1.0 + right_slope**2), -1.0, grey, low, high, steps)
            return
    for line in range(_LINES):
        y = (line + 0.5) / _LINES * 2.0 - 1.0
        left, right, _, _ = _span(outline, middle + y)
        if left < right:
            weight = (1.0 - abs(y)) * (2.0 / _LINES)
            _add_edge(left, 1.0, weight, grey, low, high, steps)
            _add_edge(right, 1.0, -weight, grey, low, high, steps)


@kernel
def _span(outline: Floats, y: float) -> tuple[float, float, float, float]:
    left, right, left_slope, right_slope = np.inf, -np.inf, 0.0, 0.0
    ax, ay = outline[-1]
    for corner in range(len(outline)):
        bx, by = outline[corner]
        if (ay <= y) != (by <= y):
            slope = (bx - ax) / (by - ay)
            x = ax + (y - ay) * slope
            if x < left:
                left, left_slope = x, slope
            if x > right:
                right, right_slope = x, slope
        ax, ay = bx, by
    return left, right, left_slope, right_slope


@kernel
def _add_edge(
    edge: float, blur: float, weight: float, grey: float, low: int, high: int, steps: Singles
) -> None:
    begin = int(min(max(edge - blur - 0.5, low), high))
    end = int(min(max(edge + blur + 1.5, low + 1.0), high))
    sharpness, before = 1.0 / blur, 0.0
    for column in range(begin, end):
        away = min(max((column + 0.5 - edge) * sharpness, -1.0), 1.0)
        after = weight * (0.5 + away - 0.5 * away * abs(away))
        steps[0, column] += after - before
        steps[1, column] += grey * (after - before)
        before = after


@kernel
def _cover(steps: Singles, low: int, high: int, bias: float, pixels: Bytes) -> None:
    zero, one, more = Single(0.0), Single(1.0), Single(bias)
    share, glow = zero, zero
    for column in range(low, high):
        share += steps[0, column]
        glow += steps[1, column]
        steps[0, column] = zero
        steps[1, column] = zero
        grey = Single(pixels[column]) * (one - min(share, one)) + glow / max(share, one)
        pixels[column] = np.uint8(np.int32(min(max(grey + more, zero), Single(255.0))))

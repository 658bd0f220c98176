"""Compiled geometry of polylines: nearest points, and whether rings contain a point."""

import math
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.jit import kernel

SAME_M = 1e-9
"""Nearer neighbours count as one point. Source: the reference simulator."""

_NEIGHBOURS = 4
_HAIR = 1e-12
"""Share of a segment, so that rounding does not put a waypoint before itself."""

START_X, START_Y, END_X, END_Y, INVERSE_SQUARE, START_M, END_M, YAW_RAD = range(8)
"""Rows of segments: both ends, one over the squared length, distances, direction."""


class Road(NamedTuple):
    """A track as `locate` needs it: `segments`, and first and last rows of vertices.

    Attributes:
        is_ccw: The inner border lies to the left.
        backward: Driven from the last row.
    """

    center: Floats
    inner: Floats
    outer: Floats
    first: Ints
    last: Ints
    closed: bool
    is_ccw: bool
    backward: bool


class Location(NamedTuple):
    """Where m points lie along and across a track. Shape (m,) unless given.

    Attributes:
        distance_m: Of the nearest centre-line point, from waypoint 0.
        center_xy: That point. Shape (m, 2).
        from_center_m: Distance from it.
        previous: The last waypoint at or before `distance_m`.
        next: The one after it, the first of repeated ones; 0 behind the last one.
        nearest: The nearer of the two.
        track_width_m: Between that point's projections on the borders.
        left_of_center: Whether the left one is nearer.
    """

    distance_m: Floats
    center_xy: Floats
    from_center_m: Floats
    previous: Ints
    next: Ints
    nearest: Ints
    track_width_m: Floats
    left_of_center: Bools


def vertices(points: Floats) -> tuple[Ints, Ints]:
    """First and last rows; rows may repeat the one before."""
    first = [0]
    for row in range(1, len(points)):
        apart = points[row] - points[first[-1]]
        if math.hypot(apart[0], apart[1]) > SAME_M:
            first.append(row)
    return np.array(first, np.int64), np.array([*first[1:], len(points)], np.int64) - 1


def without_repeats(points: Floats) -> Floats:
    """Each vertex once; the last row, which closes a ring, stays."""
    first, last = vertices(points)
    return points[[*first[:-1], last[-1]]]


def segments(points: Floats) -> Floats:
    """The segments of a polyline for this module's kernels. Shape (8, m - 1) for m vertices.

    The same numbers on every processor, because no routine of NumPy differs.
    """
    line = without_repeats(points)
    start, end = line[:-1], line[1:]
    x, y = (end - start).T
    length_m = np.hypot(x, y)
    end_m = np.cumsum(length_m)
    start_m = np.concatenate([[0.0], end_m[:-1]])
    end_m[-1:] = math.fsum(length_m)
    yaw_rad = [math.atan2(*step) for step in zip(y.tolist(), x.tolist(), strict=True)]
    return np.stack([*start.T, *end.T, 1.0 / length_m**2, start_m, end_m, yaw_rad])


@kernel
def locate(xy: Floats, road_parts: tuple[Any, ...]) -> tuple[Any, ...]:
    """The parts of the `Location` of m points, given those of a `Road`.

    A width or distance is the same number in both driving directions.
    """
    road = Road(*road_parts)
    center, first, last = road.center, road.first, road.last
    m, end = xy.shape[0], center.shape[1]
    distance_m, center_xy, from_center_m = np.empty(m), np.empty((m, 2)), np.empty(m)
    previous, following = np.empty(m, np.int64), np.empty(m, np.int64)
    nearest = np.empty(m, np.int64)
    width_m, left = np.empty(m), np.empty(m, np.bool_)
    scratch = np.empty(max(center.shape[1], road.inner.shape[1], road.outer.shape[1]))
    for i in range(m):
        x, y = xy[i, 0], xy[i, 1]
        k, along, cx, cy = _nearest(center, x, y, scratch)
        _, _, ix, iy = _nearest(road.inner, cx, cy, scratch)
        _, _, ox, oy = _nearest(road.outer, cx, cy, scratch)
        center_xy[i, 0], center_xy[i, 1] = cx, cy
        from_center_m[i] = np.hypot(x - cx, y - cy)
        width_m[i] = np.hypot(ix - ox, iy - oy)
        inner_is_nearer = np.hypot(x - ix, y - iy) < np.hypot(x - ox, y - oy)
        left[i] = inner_is_nearer == road.is_ccw

        # A point exactly at a vertex has that vertex behind it, as in a bisection to the right.
        at_vertex = along <= 0.0 or along >= 1.0
        if along >= 1.0:
            k += 1
            distance_m[i] = center[END_M, k - 1]
        else:
            distance_m[i] = _distance_m(center, k, along)
        if not road.backward:
            behind, ahead = k, k + 1 if k < end else 0
            previous[i], following[i] = last[behind], first[ahead]
        else:
            if road.closed and at_vertex and k == 0:
                k = end  # driven this way round, the lap begins there too
                distance_m[i] = center[END_M, end - 1]
            distance_m[i] = center[END_M, end - 1] - distance_m[i]
            behind = k if at_vertex else k + 1
            ahead = behind - 1 if behind > 0 else end
            previous[i], following[i] = last[end] - first[behind], last[end] - last[ahead]
        behind_is_nearer = _square_to(center, behind, x, y) <= _square_to(center, ahead, x, y)
        nearest[i] = previous[i] if behind_is_nearer else following[i]
    return distance_m, center_xy, from_center_m, previous, following, nearest, width_m, left


@kernel
def project(xy: Floats, line: Floats) -> Floats:
    distance_m, scratch = np.empty(xy.shape[0]), np.empty(line.shape[1])
    for i in range(xy.shape[0]):
        k, along, _, _ = _nearest(line, xy[i, 0], xy[i, 1], scratch)
        distance_m[i] = _distance_m(line, k, along)
    return distance_m


@kernel
def inside_road(xy: Floats, outer: Floats, inner: Floats) -> Bools:
    """Strictly inside the outer and outside the inner ring, which may be empty."""
    m = xy.shape[0]
    inside = np.empty(m, np.bool_)
    near_outer = np.empty(outer.shape[0], np.int64)
    near_inner = np.empty(inner.shape[0], np.int64)
    for begin in range(0, m, _NEIGHBOURS):
        group = xy[begin : min(begin + _NEIGHBOURS, m)]
        outer_rows = near_outer[: _edges_that_count(outer, group, near_outer)]
        inner_rows = near_inner[: _edges_that_count(inner, group, near_inner)]
        for i in range(group.shape[0]):
            x, y = group[i, 0], group[i, 1]
            inside[begin + i] = (
                _side(outer, outer_rows, x, y) > 0 and _side(inner, inner_rows, x, y) < 0
            )
    return inside


@kernel
def _nearest(line: Floats, x: float, y: float, scratch: Floats) -> tuple[int, float, float, float]:
    """Two passes, because the first then runs in vector registers. The first of equals wins."""
    n = line.shape[1]
    for k in range(n):
        along, px, py = _nearest_of(line, k, x, y)
        scratch[k] = (x - px) * (x - px) + (y - py) * (y - py)
    best = 0
    for k in range(1, n):
        if scratch[k] < scratch[best]:
            best = k
    along, px, py = _nearest_of(line, best, x, y)
    return best, along, px, py


@kernel
def _distance_m(line: Floats, k: int, along: float) -> float:
    return float(line[START_M, k] + along * (line[END_M, k] - line[START_M, k]))


@kernel
def _nearest_of(line: Floats, k: int, x: float, y: float) -> tuple[float, float, float]:
    """Ends are exact, so that neighbours are equally near there."""
    ax, ay, bx, by = line[START_X, k], line[START_Y, k], line[END_X, k], line[END_Y, k]
    along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) * line[INVERSE_SQUARE, k]
    if along >= 1.0 - _HAIR:
        return 1.0, bx, by
    if along <= _HAIR:
        return 0.0, ax, ay
    return along, ax + along * (bx - ax), ay + along * (by - ay)


@kernel
def _square_to(line: Floats, vertex: int, x: float, y: float) -> float:
    last = vertex == line.shape[1]
    x_m: float = x - (line[END_X, vertex - 1] if last else line[START_X, vertex])
    y_m: float = y - (line[END_Y, vertex - 1] if last else line[START_Y, vertex])
    return x_m * x_m + y_m * y_m


@kernel
def _edges_that_count(ring: Floats, group: Floats, rows: Ints) -> int:
    least_x, least_y, most_y = group[0, 0], group[0, 1], group[0, 1]
    for i in range(1, group.shape[0]):
        least_x = min(least_x, group[i, 0])
        least_y = min(least_y, group[i, 1])
        most_y = max(most_y, group[i, 1])
    count = 0
    for k in range(ring.shape[0] - 1):
        ay, by = ring[k, 1], ring[k + 1, 1]
        if (ay < least_y and by < least_y) or (ay > most_y and by > most_y):
            continue
        if ring[k, 0] < least_x and ring[k + 1, 0] < least_x:
            continue
        rows[count] = k
        count += 1
    return count


@kernel
def _side(ring: Floats, edges: Ints, x: float, y: float) -> int:
    """1 inside, 0 on it, -1 outside."""
    inside = False
    for k in edges:
        ax, ay, bx, by = ring[k, 0], ring[k, 1], ring[k + 1, 0], ring[k + 1, 1]
        if (ay > y) == (by > y) and ay != y and by != y:
            continue
        if ax < x and bx < x:
            continue
        if ay == y and by == y:
            if min(ax, bx) <= x <= max(ax, bx):
                return 0
            continue
        if (bx == x and by == y) or (ax == x and ay == y):
            return 0
        if (ay > y) == (by > y):
            continue
        turn = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        if turn == 0.0:
            return 0
        inside ^= (turn > 0.0) == (by > ay)
    return 1 if inside else -1

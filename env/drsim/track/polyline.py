"""Compiled geometry of polylines: the nearest point on one, and whether rings contain a point."""

import math
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.jit import kernel

SAME_M = 1e-9
"""Neighbouring points no farther apart count as one point. Source: the reference simulator."""

_NEIGHBOURS = 4
"""Points in a row that are tested together: the wheels of a car are near each other."""

_HAIR = 1e-12
"""A point this near to an end of a segment, as a share of its length, counts as that end. Otherwise
rounding could put a waypoint just before itself."""

START_X, START_Y, END_X, END_Y, INVERSE_SQUARE, START_M, END_M, YAW_RAD = range(8)
"""Rows of an array of segments: both ends, one over the squared length, the distances along the
polyline at both ends, and the direction."""


class Road(NamedTuple):
    """A track as `locate` needs it. Segments are arrays of `segments`, shape (8, ...).

    Attributes:
        center: Segments of the centre line. Shape (8, v - 1) for v vertices.
        inner: Segments of the inner border.
        outer: Segments of the outer border.
        first: First row of each vertex of the centre line. Shape (v,).
        last: Last row of each vertex. Shape (v,).
        closed: The centre line ends where it begins.
        is_ccw: The inner border lies to the left of the driving direction.
        backward: The centre line is driven from its last row to its first one; rows are then
            counted from its end.
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
    """Where m points lie relative to a track. Source: the reference simulator's definitions.

    Attributes:
        distance_m: Distance along the centre line from waypoint 0 to the centre-line point nearest
            to the point, 0 .. track length. The whole line is searched. Shape (m,).
        center_xy: That nearest centre-line point. Shape (m, 2).
        from_center_m: Distance of the point from it. Shape (m,).
        previous: Index of the last waypoint at or before `distance_m`. Shape (m,).
        next: Index of the waypoint after it; 0 behind the last one. On a closed track the last
            index is the waypoint that repeats waypoint 0. Where another waypoint repeats the one
            before, `next` is the first of the two and `previous` the second. Shape (m,).
        nearest: The one of the two that is nearer in a straight line. Shape (m,).
        track_width_m: Distance between the projections of the nearest centre-line point on the two
            borders. Shape (m,).
        left_of_center: The point lies left of the centre line as seen in the driving direction:
            the nearer of those two border points decides. Shape (m,).
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
    """First and last row of each vertex of a polyline: rows may repeat the one before.

    Shape (m,) each for rows of shape (n, 2) in metres; m <= n.
    """
    first = [0]
    for row in range(1, len(points)):
        apart = points[row] - points[first[-1]]
        if math.hypot(apart[0], apart[1]) > SAME_M:
            first.append(row)
    return np.array(first, np.int64), np.array([*first[1:], len(points)], np.int64) - 1


def without_repeats(points: Floats) -> Floats:
    """The vertices of a polyline, each once; the very last row, which closes a ring, stays."""
    first, last = vertices(points)
    return points[[*first[:-1], last[-1]]]


def segments(points: Floats) -> Floats:
    """The segments of a polyline, laid out for the kernels of this module.

    The numbers are the same on every processor: none comes from a routine that NumPy implements
    differently for different processors.

    A row of `points` may repeat the one before. The result has rows from `START_X` to `YAW_RAD`, in
    metres and radians. The length of the whole line does not depend on the end it is measured from.
    Shape (8, m - 1) for m vertices.
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
    """The parts of the `Location` of m points relative to a track, given the parts of its `Road`.

    The driving direction only decides how the result is expressed, never what is measured: a width
    or a distance is the same number for a car that has turned round.
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
    """Distances along a line of `segments` of its points nearest to m given ones. Shape (m,)."""
    distance_m, scratch = np.empty(xy.shape[0]), np.empty(line.shape[1])
    for i in range(xy.shape[0]):
        k, along, _, _ = _nearest(line, xy[i, 0], xy[i, 1], scratch)
        distance_m[i] = _distance_m(line, k, along)
    return distance_m


@kernel
def inside_road(xy: Floats, outer: Floats, inner: Floats) -> Bools:
    """Whether points lie strictly inside the outer ring and strictly outside the inner one.

    The last vertex of a ring equals the first; the inner ring may have none at all. A point exactly
    on a border is not on the road. Shape (m,) for m points.
    """
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
    """Segment nearest to a point, how far along it (0 .. 1), and the nearest point itself.

    Two passes, because the first one, which holds the arithmetic, then runs in vector registers.
    Of equally near segments the first one wins.
    """
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
    """Distance along a polyline of the place at a share (0 .. 1) of segment k."""
    distance_m: float = line[START_M, k] + along * (line[END_M, k] - line[START_M, k])
    return distance_m


@kernel
def _nearest_of(line: Floats, k: int, x: float, y: float) -> tuple[float, float, float]:
    """How far along segment k (0 .. 1) its point nearest to a point lies, and that point.

    Both ends are met exactly, so that two segments are equally near where they join.
    """
    ax, ay, bx, by = line[START_X, k], line[START_Y, k], line[END_X, k], line[END_Y, k]
    along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) * line[INVERSE_SQUARE, k]
    if along >= 1.0 - _HAIR:
        return 1.0, bx, by
    if along <= _HAIR:
        return 0.0, ax, ay
    return along, ax + along * (bx - ax), ay + along * (by - ay)


@kernel
def _square_to(line: Floats, vertex: int, x: float, y: float) -> float:
    """Squared distance from a point to a vertex of a polyline."""
    last = vertex == line.shape[1]
    x_m: float = x - (line[END_X, vertex - 1] if last else line[START_X, vertex])
    y_m: float = y - (line[END_Y, vertex - 1] if last else line[START_Y, vertex])
    return x_m * x_m + y_m * y_m


@kernel
def _edges_that_count(ring: Floats, group: Floats, rows: Ints) -> int:
    """Pick the edges of a ring, shape (n, 2), that can decide whether points lie inside it.

    A ray towards +x meets no edge that lies above, below or to the left of all points. The indices
    of the others are written to `rows`, shape (n,) or more.

    Returns:
        How many there are.
    """
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
    """1 strictly inside a ring, 0 on it, -1 outside; by the crossings of a ray towards +x."""
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

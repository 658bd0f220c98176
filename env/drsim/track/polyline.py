"""Compiled geometry of polylines: the nearest point on one, and whether rings contain a point."""

import math

import numpy as np
from numpy.typing import NDArray

from drsim.jit import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAME_M = 1e-9
"""Neighbouring points no farther apart count as one point. Source: the reference simulator."""

_NEIGHBOURS = 4
"""Points in a row that are tested together: the wheels of a car are near each other."""

_HAIR = 1e-12
"""A point this near to an end of a segment, as a share of its length, counts as that end: a
waypoint itself must not come out as a hair before the waypoint, which is all that rounding leaves
of it."""


def vertices(points: Floats) -> tuple[Ints, Ints]:
    """Rows of a polyline that are one and the same point, because a row repeats the one before.

    Args:
        points: Rows in metres. Shape (n, 2).

    Returns:
        First and last row of each vertex. Each of shape (m,), m <= n.
    """
    first = [0]
    for row in range(1, len(points)):
        apart = points[row] - points[first[-1]]
        if math.hypot(apart[0], apart[1]) > SAME_M:
            first.append(row)
    return np.array(first, np.int64), np.array([*first[1:], len(points)], np.int64) - 1


def without_repeats(points: Floats) -> Floats:
    """The vertices of a polyline, each once; the very last row, which closes a ring, stays.

    Args:
        points: Rows in metres. Shape (n, 2).

    Returns:
        Shape (m, 2), m <= n.
    """
    first, last = vertices(points)
    return points[[*first[:-1], last[-1]]]


def segments(points: Floats) -> Floats:
    """The segments of a polyline, laid out for the kernels of this module.

    The figures are the same on every processor: none comes from a routine that NumPy has more than
    one of.

    Args:
        points: Rows in metres; a row may repeat the one before. Shape (n, 2).

    Returns:
        Rows: x and y where each segment starts, x and y where it ends, the inverse of its squared
        length, the distance along the polyline where it starts and where it ends, and its
        direction in radians. The length of the whole line does not depend on the end from which
        it is measured. Shape (8, m - 1) for m vertices.
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
def locate(
    xy: Floats,
    center: Floats,
    inner: Floats,
    outer: Floats,
    first: Ints,
    last: Ints,
    closed: bool,
    is_ccw: bool,
    backward: bool,
) -> tuple[Floats, Floats, Floats, Ints, Ints, Ints, Floats, Bools]:
    """Where points lie relative to a track.

    Which way it is driven decides how the result is told, and about nothing that is measured: a
    width or a distance is the same number for a car that has turned round.

    Args:
        xy: Points in metres. Shape (m, 2).
        center: Segments of the centre line. Shape (8, v - 1) for v vertices.
        inner: Segments of the inner border. Shape (8, ...).
        outer: Segments of the outer border. Shape (8, ...).
        first: First row of each vertex of the centre line. Shape (v,).
        last: Last row of each. Shape (v,).
        closed: Whether the centre line ends where it begins.
        is_ccw: Whether the inner border lies to the left of the driving direction.
        backward: Whether it is driven from its last row to its first one; rows are then counted
            from its end.

    Returns:
        The fields of `drsim.track.track.Location`, in their order.
    """
    m, end = xy.shape[0], center.shape[1]
    distance_m, center_xy, from_center_m = np.empty(m), np.empty((m, 2)), np.empty(m)
    previous, following, nearest = (
        np.empty(m, np.int64),
        np.empty(m, np.int64),
        np.empty(m, np.int64),
    )
    width_m, left = np.empty(m), np.empty(m, np.bool_)
    scratch = np.empty(max(center.shape[1], inner.shape[1], outer.shape[1]))
    for i in range(m):
        x, y = xy[i, 0], xy[i, 1]
        k, along, cx, cy = _nearest(center, x, y, scratch)
        _, _, ix, iy = _nearest(inner, cx, cy, scratch)
        _, _, ox, oy = _nearest(outer, cx, cy, scratch)
        center_xy[i, 0], center_xy[i, 1] = cx, cy
        from_center_m[i] = np.hypot(x - cx, y - cy)
        width_m[i] = np.hypot(ix - ox, iy - oy)
        inner_is_nearer = np.hypot(x - ix, y - iy) < np.hypot(x - ox, y - oy)
        left[i] = inner_is_nearer == is_ccw

        # A point exactly at a vertex has that vertex behind it, as in a bisection to the right.
        at_vertex = along <= 0.0 or along >= 1.0
        if along >= 1.0:
            k += 1
            distance_m[i] = center[6, k - 1]
        else:
            distance_m[i] = center[5, k] + along * (center[6, k] - center[5, k])
        if not backward:
            behind, ahead = k, k + 1 if k < end else 0
            previous[i], following[i] = last[behind], first[ahead]
        else:
            if closed and at_vertex and k == 0:
                k = end  # driven this way round, the lap begins there too
                distance_m[i] = center[6, end - 1]
            distance_m[i] = center[6, end - 1] - distance_m[i]
            behind = k if at_vertex else k + 1
            ahead = behind - 1 if behind > 0 else end
            previous[i], following[i] = last[end] - first[behind], last[end] - last[ahead]
        behind_is_nearer = _square_to(center, behind, x, y) <= _square_to(center, ahead, x, y)
        nearest[i] = previous[i] if behind_is_nearer else following[i]
    return distance_m, center_xy, from_center_m, previous, following, nearest, width_m, left


@kernel
def project(xy: Floats, line: Floats) -> Floats:
    """Distance along a polyline of its points nearest to the given ones.

    Args:
        xy: Points in metres. Shape (m, 2).
        line: Segments. Shape (8, n - 1).

    Returns:
        Distances in metres. Shape (m,).
    """
    distance_m, scratch = np.empty(xy.shape[0]), np.empty(line.shape[1])
    for i in range(xy.shape[0]):
        k, along, _, _ = _nearest(line, xy[i, 0], xy[i, 1], scratch)
        distance_m[i] = line[5, k] + along * (line[6, k] - line[5, k])
    return distance_m


@kernel
def inside_road(xy: Floats, outer: Floats, inner: Floats) -> Bools:
    """Whether points lie strictly inside the outer ring and strictly outside the inner one.

    Args:
        xy: Points in metres. Shape (m, 2).
        outer: Vertices of the outer ring, the last equal to the first. Shape (n, 2).
        inner: Vertices of the hole, likewise, or none at all. Shape (k, 2).

    Returns:
        True where the point is on the road; a point exactly on a border is not. Shape (m,).
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
def _nearest_of(line: Floats, k: int, x: float, y: float) -> tuple[float, float, float]:
    """How far along segment k (0 .. 1) its point nearest to a point lies, and that point.

    Both ends are met exactly, so that two segments are equally near where they join.
    """
    ax, ay, bx, by = line[0, k], line[1, k], line[2, k], line[3, k]
    along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) * line[4, k]
    if along >= 1.0 - _HAIR:
        return 1.0, bx, by
    if along <= _HAIR:
        return 0.0, ax, ay
    return along, ax + along * (bx - ax), ay + along * (by - ay)


@kernel
def _square_to(line: Floats, vertex: int, x: float, y: float) -> float:
    """Squared distance from a point to a vertex of a polyline."""
    last = vertex == line.shape[1]
    x_m: float = x - (line[2, vertex - 1] if last else line[0, vertex])
    y_m: float = y - (line[3, vertex - 1] if last else line[1, vertex])
    return x_m * x_m + y_m * y_m


@kernel
def _edges_that_count(ring: Floats, group: Floats, rows: Ints) -> int:
    """Pick the edges of a ring that can decide on which side of it some points lie.

    Args:
        ring: Vertices. Shape (n, 2).
        group: The points. Shape (m, 2).
        rows: Where to put the edges' indices. Shape (n,) or more.

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
    """1 strictly inside a ring, 0 on it, -1 outside; by the crossings of a ray towards +x.

    Only the given edges of the ring are looked at.
    """
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

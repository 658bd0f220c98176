"""A closed cubic spline through points."""

import math

import numpy as np

from drsim.arrays import Bools, Floats, Ints, Singles
from drsim.jit import kernel

_STEPS_PER_PIECE = 200


class ClosedSpline:
    """The smoothest closed curve through points, continuous in curvature.

    Metres, shape (k, 2), k >= 3, no neighbours equal, the first not repeated.
    """

    def __init__(self, points: Floats) -> None:
        self._points = points
        self._chord_m = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
        self._slope = _slopes(points, self._chord_m)
        piece = np.repeat(np.arange(len(points)), _STEPS_PER_PIECE)
        share = np.tile(np.arange(_STEPS_PER_PIECE) / _STEPS_PER_PIECE, len(points))
        xy, _ = self._evaluate(piece, share)
        step_m = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
        self._along_m = np.concatenate([[0.0], np.cumsum(step_m)])

    @property
    def length_m(self) -> float:
        return float(self._along_m[-1])

    def at(self, distance_m: Floats) -> tuple[Floats, Floats]:
        """Points at distances from the first one, and unit vectors along the curve."""
        wrapped_m = distance_m % self.length_m
        parameter = np.interp(wrapped_m, self._along_m, np.arange(len(self._along_m)))
        piece, share = np.divmod(parameter / _STEPS_PER_PIECE, 1.0)
        xy, slope = self._evaluate(piece.astype(np.int64) % len(self._points), share)
        return xy, slope / np.hypot(*slope.T)[:, None]

    def _evaluate(self, piece: Ints, share: Floats) -> tuple[Floats, Floats]:
        following = (piece + 1) % len(self._points)
        p, q = self._points[piece], self._points[following]
        h = self._chord_m[piece][:, None]
        u, v = self._slope[piece] * h, self._slope[following] * h
        t = share[:, None]
        bend, twist = 3 * (q - p) - 2 * u - v, 2 * (p - q) + u + v
        return ((twist * t + bend) * t + u) * t + p, ((3 * twist * t + 2 * bend) * t + u) / h


def _slopes(points: Floats, chord_m: Floats) -> Floats:
    """Such that the second derivative is continuous; see `lanes._slopes`."""
    k = len(points)
    here, before, after = np.arange(k), np.arange(k) - 1, (np.arange(k) + 1) % k
    secant = (points[after] - points) / chord_m[:, None]
    a, b = chord_m[before], chord_m
    matrix = np.zeros((k, k))
    np.add.at(matrix, (here, before), b)
    np.add.at(matrix, (here, here), 2 * (a + b))
    np.add.at(matrix, (here, after), a)
    right = 3 * (b[:, None] * secant[before] + a[:, None] * secant)
    return _solved(matrix, right)


def _solved(matrix: Floats, right: Floats) -> Floats:
    """By elimination, so that waypoints are the same on every processor.

    Libraries add in another order on each kind.
    """
    rows = np.concatenate([matrix, right], axis=1)
    for k in range(len(matrix)):
        rows[k] /= rows[k, k]
        factor = rows[:, k : k + 1].copy()
        factor[k] = 0.0
        rows -= factor * rows[k]
    return rows[:, len(matrix) :]


# Which cells of a grid lie on the road: an odd number of borders to their left.


@kernel
def cross_ring(ring: Floats, crossed: Bools) -> None:
    rows, columns = crossed.shape
    for i in range(len(ring)):
        ax, ay = ring[i - 1]
        bx, by = ring[i]
        low, high = min(ay, by), max(ay, by)
        for row in range(max(math.ceil(low), 0), min(math.ceil(high), rows)):
            column = max(math.ceil(ax + (row - ay) / (by - ay) * (bx - ax)), 0)
            if column < columns:
                crossed[row, column] = not crossed[row, column]


@kernel
def sign_off_road(crossed: Bools, distance: Singles) -> None:
    rows, columns = crossed.shape
    for row in range(rows):
        on_road = False
        for column in range(columns):
            on_road ^= crossed[row, column]
            if not on_road:
                distance[row, column] = -distance[row, column]

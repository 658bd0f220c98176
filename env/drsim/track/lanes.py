"""Both lanes as smooth curves, for bots that drive without physics."""

import math
from typing import NamedTuple

import numpy as np

from drsim.arrays import Floats, Ints
from drsim.jit import kernel
from drsim.track.track import LANES, Lane, Track

_TABLE_STEP_M = 0.02
_LOOK_AHEAD_M = 0.05
_LEAST_STEP_M = 0.01
"""Nearer vertices would cause a jerk."""

_FARTHEST_M = 1.0
_OVERHANG = 12
"""The ends then matter less than a thousandth of a millimetre."""


class LanePlaces(NamedTuple):
    """Where bots are, shape (n, k).

    `share` is 0 on the inner lane, 1 on the outer.
    """

    distance_m: Floats
    share: Floats
    drift: Floats


class LanePaths:
    """Both lanes of a track as cubic splines over the distance along the centre line.

    So a bot is faster on the outer lane of a curve, as in the reference simulator.
    """

    def __init__(self, tracks: tuple[Track, Track]) -> None:
        self._length_m = tracks[0].length_m
        steps = int(np.ceil(self._length_m / _TABLE_STEP_M))
        self._step_m = self._length_m / steps
        beyond = int(np.ceil(_LOOK_AHEAD_M / self._step_m)) + 1
        at_m = self._step_m * np.arange(steps + beyond + 1, dtype=np.float64)
        self._xy = np.array(
            [[_spline(*_knots(track, lane), at_m) for lane in LANES[1:]] for track in tracks]
        )

    def poses(self, backward: Ints, places: LanePlaces) -> tuple[Floats, Floats]:
        """Centres in metres, shape (n, k, 2), and yaws in radians.

        At the end of an open track a bot begins again, so that none blocks the finish.
        """
        here_m = places.distance_m % self._length_m
        return _poses(self._xy, self._step_m, backward, (here_m, places.share, places.drift))


def _knots(track: Track, lane: Lane) -> tuple[Floats, Floats]:
    border = track.inner if lane == "inner" else track.outer
    vertices = (track.center + border) / 2
    row_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track.center, axis=0).T))])
    off_m = track.locate(vertices).distance_m - row_m
    if track.closed:
        # A vertex beside the start may project behind the finish line, and the other way round.
        off_m = (off_m + track.length_m / 2) % track.length_m - track.length_m / 2
    places_m = row_m + np.where(np.abs(off_m) < _FARTHEST_M, off_m, 0.0)
    if track.closed:
        vertices, places_m = vertices[:-1], places_m[:-1]
    end_m = places_m[0] + track.length_m if track.closed else np.inf
    kept = [0]
    for k, place_m in enumerate(places_m):
        if places_m[kept[-1]] + _LEAST_STEP_M < place_m < end_m - _LEAST_STEP_M:
            kept.append(k)
    vertices, places_m = vertices[kept], places_m[kept]
    if not track.closed:
        return vertices, places_m
    lap, row = np.divmod(np.arange(-_OVERHANG, len(kept) + _OVERHANG), len(kept))
    return vertices[row], places_m[row] + lap * track.length_m


def _spline(points: Floats, knots: Floats, at: Floats) -> Floats:
    gap = np.diff(knots)
    slope = _slopes(points, gap)
    k = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(gap) - 1)
    h = gap[k][:, None]
    t = (at - knots[k])[:, None] / h
    p, q, u, v = points[k], points[k + 1], slope[k] * h, slope[k + 1] * h
    bend, twist = 3 * (q - p) - 2 * u - v, 2 * (p - q) + u + v
    curve: Floats = ((twist * t + bend) * t + u) * t + p
    return curve


def _slopes(points: Floats, gap: Floats) -> Floats:
    """Such that the second derivative is continuous; secants at the ends.

    b * slope_before + 2 (a + b) * slope + a * slope_after = 3 (b * secant_before + a * secant),
    with gaps a before and b after a knot.
    """
    secant = np.diff(points, axis=0) / gap[:, None]
    slope = secant[[0, *range(len(gap))]]
    a, b = gap[:-1], gap[1:]
    diagonal = 2 * (a + b)
    right = 3 * (b[:, None] * secant[:-1] + a[:, None] * secant[1:])
    right[:1] -= b[:1, None] * slope[:1]
    for k in range(1, len(a)):
        factor = b[k] / diagonal[k - 1]
        diagonal[k] -= factor * a[k - 1]
        right[k] -= factor * right[k - 1]
    for k in reversed(range(len(a))):
        slope[k + 1] = (right[k] - a[k] * slope[k + 2]) / diagonal[k]
    return slope


@kernel
def _poses(
    lanes: Floats, step_m: float, backward: Ints, places: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats]:
    distance_m, shares, drift = places
    cars, bots = shares.shape
    xy, yaw_rad = np.empty((cars, bots, 2)), np.empty((cars, bots))
    for i in range(cars):
        inner, outer = lanes[backward[i], 0], lanes[backward[i], 1]
        for k in range(bots):
            here_m, share = distance_m[i, k], shares[i, k]
            x, y = _between(inner, outer, here_m / step_m, share)
            ahead_m = here_m + _LOOK_AHEAD_M
            aside = share + _LOOK_AHEAD_M * drift[i, k]
            ahead_x, ahead_y = _between(inner, outer, ahead_m / step_m, aside)
            xy[i, k, 0], xy[i, k, 1] = x, y
            yaw_rad[i, k] = math.atan2(ahead_y - y, ahead_x - x)
    return xy, yaw_rad


@kernel
def _between(inner: Floats, outer: Floats, place: float, share: float) -> tuple[float, float]:
    row = int(place)
    part = place - row
    a, b = (1.0 - part) * (1.0 - share), part * (1.0 - share)
    c, d = (1.0 - part) * share, part * share
    x = a * inner[row, 0] + b * inner[row + 1, 0] + c * outer[row, 0] + d * outer[row + 1, 0]
    y = a * inner[row, 1] + b * inner[row + 1, 1] + c * outer[row, 1] + d * outer[row + 1, 1]
    return x, y

"""Bot cars: slow cars without physics that follow the lanes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.car.car import CONTROL_HZ
from drsim.jit import kernel
from drsim.race.race import BotRules
from drsim.track.track import LANES, Lane, Track
from drsim.track.ways import Ways

_SHORTEST_CHANGE_M = 0.01


class _LaneChanges(NamedTuple):
    """Arrays of shape (n, k); `lane` is 0 inner, 1 outer, the one a bot is on or leaves."""

    lane: Ints
    wait_s: Floats
    changed_m: Floats


class Bots:
    """The bots of n cars, k for each; a car meets only its own."""

    def __init__(self, num_cars: int, rules: BotRules) -> None:
        shape = (num_cars, rules.count)
        self.rules = rules
        self.places = LanePlaces(np.zeros(shape), np.zeros(shape), np.zeros(shape))
        self._changes = _LaneChanges(
            lane=np.zeros(shape, np.int64),
            wait_s=np.full(shape, np.inf),
            changed_m=np.zeros(shape),
        )
        self._halt_s: Floats = np.zeros(num_cars)
        self._random: list[np.random.Generator | None] = [None] * num_cars

    @property
    def _changes_lanes(self) -> bool:
        return self.rules.lane_change and self.rules.speed_mps > 0

    @property
    def moving_mps(self) -> Floats:
        """Speed, 0 for bots that were run into. Shape (n,)."""
        return np.where(self._halt_s > 0.0, 0.0, self.rules.speed_mps)

    def begin(self, car: int, places_m: Floats, lanes: Ints, random: np.random.Generator) -> None:
        """Put a car's k bots at the start of its episode, on lanes 0 (inner) or 1 (outer).

        Lane changes are drawn from `random` now and during the episode.
        """
        self.places.distance_m[car] = places_m
        self.places.share[car] = lanes
        self.places.drift[car] = 0.0
        self._changes.lane[car] = lanes
        self._changes.changed_m[car] = 0.0
        self._halt_s[car] = 0.0
        self._random[car] = random
        if self._changes_lanes:
            self._changes.wait_s[car] = random.uniform(*self.rules.lane_change_time_s, len(lanes))

    def advance(self, moving: Bools) -> None:
        step_s = 1.0 / CONTROL_HZ
        halted = self._halt_s > 0
        self._halt_s[moving & halted] -= step_s
        # What rounding leaves of a wait is not one.
        self._halt_s[self._halt_s < 1e-9] = 0.0
        going = moving & ~halted
        step_m = self.rules.speed_mps * step_s
        self.places.distance_m[going] += step_m
        if self._changes_lanes:
            self._change_lanes(going, step_s, step_m)

    def halt(self, cars: Bools) -> None:
        """Stop all bots of some cars for the penalty, unless they wait already."""
        self._halt_s[cars & (self._halt_s == 0.0)] = self.rules.penalty_s

    def _change_lanes(self, going: Bools, step_s: float, step_m: float) -> None:
        change_m = max(self.rules.lane_change_distance_m, _SHORTEST_CHANGE_M)
        across = self.places.share, self.places.drift
        arrived = _drift(going, step_s, step_m, change_m, self._changes, *across)
        for car, bot in np.argwhere(arrived):
            random = self._random[car]
            assert random is not None, "a bot that drives has begun"
            self._changes.wait_s[car, bot] = random.uniform(*self.rules.lane_change_time_s)


@kernel
def _drift(
    going: Bools,
    step_s: float,
    step_m: float,
    change_m: float,
    changes: _LaneChanges,
    share: Floats,
    drift: Floats,
) -> Bools:
    """A lane change follows 3 p^2 - 2 p^3: it begins and ends along the lane."""
    arrived: Bools = np.zeros(share.shape, np.bool_)
    for i in np.flatnonzero(going):
        for k in range(arrived.shape[1]):
            changes.wait_s[i, k] -= step_s
            if changes.wait_s[i, k] > -step_s:
                continue
            changes.changed_m[i, k] += step_m
            part = min(changes.changed_m[i, k] / change_m, 1.0)
            across = part * part * (3.0 - 2.0 * part)
            steep = 6.0 * part * (1.0 - part) / change_m
            outwards = changes.lane[i, k] == 0
            share[i, k] = across if outwards else 1.0 - across
            drift[i, k] = steep if outwards else -steep
            if part >= 1.0:
                changes.lane[i, k] = 1 - changes.lane[i, k]
                changes.changed_m[i, k] = 0.0
                arrived[i, k] = True
    return arrived


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
    """Both lanes of each way as cubic splines over the distance along the centre line.

    So a bot is faster on the outer lane of a curve, as in the reference simulator.
    """

    def __init__(self, tracks: Sequence[Track]) -> None:
        lengths_m = np.array([track.length_m for track in tracks])
        steps = np.ceil(lengths_m / _TABLE_STEP_M)
        self._step_m = lengths_m / steps
        rows = (steps + np.ceil(_LOOK_AHEAD_M / self._step_m)).astype(int) + 2
        self._xy = np.zeros((len(tracks), 2, rows.max(), 2))
        for track, xy, step_m, count in zip(tracks, self._xy, self._step_m, rows, strict=True):
            at_m = step_m * np.arange(count, dtype=np.float64)
            for side, lane in enumerate(LANES[1:]):
                xy[side, :count] = _spline(*_knots(track, lane), at_m)

    def poses(self, ways: Ways, places: LanePlaces) -> tuple[Floats, Floats]:
        """Centres in metres, shape (n, k, 2), and yaws in radians.

        At the end of an open track a bot begins again, so that none blocks the finish.
        """
        here_m = places.distance_m % ways.length_m[:, None]
        return _poses(self._xy, self._step_m, ways.way, (here_m, places.share, places.drift))


def _knots(track: Track, lane: Lane) -> tuple[Floats, Floats]:
    vertices = (track.center + (track.inner if lane == "inner" else track.outer)) / 2
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
    return ((twist * t + bend) * t + u) * t + p


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
    lanes: Floats, steps_m: Floats, ways: Ints, places: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats]:
    distance_m, shares, drift = places
    cars, bots = shares.shape
    xy, yaw_rad = np.empty((cars, bots, 2)), np.empty((cars, bots))
    for i in range(cars):
        inner, outer, step_m = lanes[ways[i], 0], lanes[ways[i], 1], steps_m[ways[i]]
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

"""Bot cars: slow cars without physics that follow the lanes of the track as time goes by."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drsim.car import CONTROL_HZ
from drsim.race import BotRules
from drsim.track import Lane, Track

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_LANES: tuple[Lane, Lane] = ("inner", "outer")
_TABLE_STEP_M = 0.02
_LOOK_AHEAD_M = 0.05
"""A bot looks towards where it will be after this distance."""


class LanePaths:
    """The inner and the outer lane as smooth curves over the distance along the centre line.

    Cubic pieces through the vertices of the lane, continuous in direction. A bot that keeps its
    speed along the centre line is therefore faster on the outer lane, as in the reference.
    """

    def __init__(self, track: Track) -> None:
        """Tabulate both lanes at steps of 2 cm."""
        self._length_m = track.length_m
        self._closed = track.closed
        steps = max(int(np.ceil(track.length_m / _TABLE_STEP_M)), 4)
        self._step_m = track.length_m / steps
        self._xy = np.stack([_smooth(track, lane, steps) for lane in _LANES])

    def at(self, distance_m: Floats, share: Floats) -> Floats:
        """Points between the lanes.

        Args:
            distance_m: Distances along the centre line. Shape (...).
            share: 0 on the inner lane, 1 on the outer one. Shape (...).

        Returns:
            Metres. Shape (..., 2).
        """
        place = distance_m % self._length_m if self._closed else distance_m
        place = np.clip(place / self._step_m, 0.0, self._xy.shape[1] - 1.001)
        index = place.astype(np.int64)
        part = (place - index)[..., None]
        inner, outer = (line[index] + part * (line[index + 1] - line[index]) for line in self._xy)
        between: Floats = inner + share[..., None] * (outer - inner)
        return between


def _smooth(track: Track, lane: Lane, steps: int) -> Floats:
    """Points of a lane at even distances along the centre line. Shape (steps + 1, 2)."""
    border = track.inner if lane == "inner" else track.outer
    vertices = (track.center + border) / 2
    knots_m = track.locate(vertices).distance_m
    if track.closed:
        vertices, knots_m = vertices[:-1], knots_m[:-1]
        # A vertex beside the finish line may be nearer to the end of the line than to its start.
        knots_m[0] -= track.length_m * round(knots_m[0] / track.length_m)
    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(knots_m)) > 1e-6])
    vertices, knots_m = vertices[rising], knots_m[rising]
    if track.closed:
        behind, ahead = slice(-3, None), slice(0, 3)
        vertices = np.concatenate([vertices[behind], vertices, vertices[ahead]])
        knots_m = np.concatenate(
            [
                knots_m[behind] - track.length_m,
                knots_m,
                knots_m[ahead] + track.length_m,
            ]
        )
    gap_m = np.diff(knots_m)
    secant = np.diff(vertices, axis=0) / gap_m[:, None]
    slope = np.empty_like(vertices)
    slope[0], slope[-1] = secant[0], secant[-1]
    before, after = gap_m[:-1, None], gap_m[1:, None]
    slope[1:-1] = (after * secant[:-1] + before * secant[1:]) / (before + after)

    at_m = np.linspace(0.0, track.length_m, steps + 1)
    k = np.clip(np.searchsorted(knots_m, at_m, side="right") - 1, 0, len(gap_m) - 1)
    h = gap_m[k][:, None]
    t = ((at_m - knots_m[k]) / gap_m[k])[:, None]
    p, q, u, v = vertices[k], vertices[k + 1], slope[k] * h, slope[k + 1] * h
    bend, twist = 3 * (q - p) - 2 * u - v, 2 * (p - q) + u + v
    points: Floats = ((twist * t + bend) * t + u) * t + p
    return points


class Bots:
    """The bots of n cars, k for each; a car meets its own only.

    Attributes:
        distance_m: Distances along the centre line in the car's driving direction. Shape (n, k).
        share: 0 on the inner lane, 1 on the outer one, between them during a change. Shape (n, k).
        drift: Change of that share per metre. Shape (n, k).
    """

    def __init__(self, num_cars: int, rules: BotRules) -> None:
        """Prepare bots that are nowhere yet."""
        shape = (num_cars, rules.count)
        self._rules = rules
        self.distance_m: Floats = np.zeros(shape)
        self.share: Floats = np.zeros(shape)
        self.drift: Floats = np.zeros(shape)
        self._lane: Ints = np.zeros(shape, np.int64)
        self._wait_s: Floats = np.full(shape, np.inf)
        self._changed_m: Floats = np.zeros(shape)
        self._halt_s: Floats = np.zeros(num_cars)
        self._random: list[np.random.Generator | None] = [None] * num_cars

    @property
    def changes_lanes(self) -> bool:
        """Whether any bot ever leaves its lane: one that stands still cannot."""
        return self._rules.lane_change and self._rules.speed_mps > 0

    def begin(self, car: int, places_m: Floats, lanes: Ints, random: np.random.Generator) -> None:
        """Put the bots of a car at the start of its episode.

        Args:
            car: Which car.
            places_m: Distances along the centre line. Shape (k,).
            lanes: 0 inner, 1 outer. Shape (k,).
            random: Where lane changes are drawn from, now and during the episode.
        """
        self.distance_m[car] = places_m
        self._lane[car] = lanes
        self.share[car] = lanes
        self.drift[car] = 0.0
        self._changed_m[car] = 0.0
        self._halt_s[car] = 0.0
        self._random[car] = random
        if self.changes_lanes:
            self._wait_s[car] = random.uniform(*self._rules.lane_change_time_s, len(lanes))

    def advance(self, moving: Bools) -> None:
        """Let 1/15 s go by for the bots of some cars. Shape (n,)."""
        step_s = 1.0 / CONTROL_HZ
        halted = self._halt_s > 0
        self._halt_s[moving & halted] -= step_s
        # A hair of a step that rounding leaves is no wait.
        self._halt_s[self._halt_s < 1e-9] = 0.0
        going = moving & ~halted
        step_m = self._rules.speed_mps * step_s
        self.distance_m[going] += step_m
        if self.changes_lanes:
            self._change_lanes(going, step_s, step_m)

    def halt(self, cars: Bools) -> None:
        """Stop all bots of some cars for the penalty, unless they wait already. Shape (n,)."""
        self._halt_s[cars & (self._halt_s == 0.0)] = self._rules.penalty_s

    def _change_lanes(self, going: Bools, step_s: float, step_m: float) -> None:
        changing = (self._wait_s <= 0.0) & going[:, None]
        self._wait_s[going] -= step_s
        self._changed_m[changing] += step_m
        length_m = max(self._rules.lane_change_distance_m, 1e-6)
        part = np.clip(self._changed_m / length_m, 0.0, 1.0)
        smooth = part * part * (3.0 - 2.0 * part)
        self.share = np.where(self._lane == 0, smooth, 1.0 - smooth)
        steep = 6.0 * part * (1.0 - part) / length_m
        self.drift = np.where(self._lane == 0, steep, -steep)
        for car, bot in np.argwhere(changing & (part >= 1.0)):
            self._lane[car, bot] = 1 - self._lane[car, bot]
            self._changed_m[car, bot] = 0.0
            random = self._random[car]
            assert random is not None, "a bot that drives has begun"
            self._wait_s[car, bot] = random.uniform(*self._rules.lane_change_time_s)


def poses_of(bots: Bots, paths: Sequence[LanePaths], backward: Ints) -> tuple[Floats, Floats]:
    """Where bots are, and where they look.

    Args:
        bots: The bots.
        paths: Of the track as given, and reversed.
        backward: Index into `paths` for each car. Shape (n,).

    Returns:
        Centres in metres, shape (n, k, 2), and yaws in radians, shape (n, k).
    """
    here, ahead = np.empty((*bots.share.shape, 2)), np.empty((*bots.share.shape, 2))
    ahead_m = bots.distance_m + _LOOK_AHEAD_M
    ahead_share = bots.share + _LOOK_AHEAD_M * bots.drift
    for direction, path in enumerate(paths):
        cars = backward == direction
        if cars.any():
            here[cars] = path.at(bots.distance_m[cars], bots.share[cars])
            ahead[cars] = path.at(ahead_m[cars], ahead_share[cars])
    step = ahead - here
    return here, np.arctan2(step[..., 1], step[..., 0])

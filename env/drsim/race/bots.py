"""Bot cars: slow cars without physics that follow the lanes."""

from typing import NamedTuple

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.car.car import CONTROL_HZ
from drsim.jit import kernel
from drsim.race.race import BotRules
from drsim.track.lanes import LanePlaces

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
        self._rules = rules
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
        return self._rules.lane_change and self._rules.speed_mps > 0

    @property
    def moving_mps(self) -> Floats:
        """Speed, 0 for bots that were run into. Shape (n,)."""
        return np.where(self._halt_s > 0.0, 0.0, self._rules.speed_mps)

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
            self._changes.wait_s[car] = random.uniform(*self._rules.lane_change_time_s, len(lanes))

    def advance(self, moving: Bools) -> None:
        step_s = 1.0 / CONTROL_HZ
        halted = self._halt_s > 0
        self._halt_s[moving & halted] -= step_s
        # What rounding leaves of a wait is not one.
        self._halt_s[self._halt_s < 1e-9] = 0.0
        going = moving & ~halted
        step_m = self._rules.speed_mps * step_s
        self.places.distance_m[going] += step_m
        if self._changes_lanes:
            self._change_lanes(going, step_s, step_m)

    def halt(self, cars: Bools) -> None:
        """Stop all bots of some cars for the penalty, unless they wait already."""
        self._halt_s[cars & (self._halt_s == 0.0)] = self._rules.penalty_s

    def _change_lanes(self, going: Bools, step_s: float, step_m: float) -> None:
        change_m = max(self._rules.lane_change_distance_m, _SHORTEST_CHANGE_M)
        across = self.places.share, self.places.drift
        arrived = _drift(going, step_s, step_m, change_m, self._changes, *across)
        for car, bot in np.argwhere(arrived):
            random = self._random[car]
            assert random is not None, "a bot that drives has begun"
            self._changes.wait_s[car, bot] = random.uniform(*self._rules.lane_change_time_s)


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

"""Bot cars: slow cars without physics that follow the lanes of the track as time goes by."""

import numpy as np
from numpy.typing import NDArray

from drsim.car.car import CONTROL_HZ
from drsim.jit import kernel
from drsim.race.race import BotRules

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_SHORTEST_CHANGE_M = 0.01
"""No lane change is shorter, so that none divides by nothing."""


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
        arrived = np.zeros(self.share.shape, np.bool_)
        _drift(
            going,
            step_s,
            step_m,
            max(self._rules.lane_change_distance_m, _SHORTEST_CHANGE_M),
            self._lane,
            self._wait_s,
            self._changed_m,
            self.share,
            self.drift,
            arrived,
        )
        for car, bot in np.argwhere(arrived):
            random = self._random[car]
            assert random is not None, "a bot that drives has begun"
            self._wait_s[car, bot] = random.uniform(*self._rules.lane_change_time_s)


@kernel
def _drift(
    going: Bools,
    step_s: float,
    step_m: float,
    change_m: float,
    lane: Ints,
    wait_s: Floats,
    changed_m: Floats,
    share: Floats,
    drift: Floats,
    arrived: Bools,
) -> None:
    """Let the bots of some cars wait or change lanes for one step; from `lane` on, all is written.

    Across the lanes a change is smooth: it begins and ends along the lane.
    """
    for i in np.flatnonzero(going):
        for k in range(share.shape[1]):
            wait_s[i, k] -= step_s
            if wait_s[i, k] > -step_s:
                continue
            changed_m[i, k] += step_m
            part = min(changed_m[i, k] / change_m, 1.0)
            across = part * part * (3.0 - 2.0 * part)
            steep = 6.0 * part * (1.0 - part) / change_m
            share[i, k] = across if lane[i, k] == 0 else 1.0 - across
            drift[i, k] = steep if lane[i, k] == 0 else -steep
            if part >= 1.0:
                lane[i, k] = 1 - lane[i, k]
                changed_m[i, k] = 0.0
                arrived[i, k] = True

"""Draws an episode's seeds, conditions, lights and colours."""

from collections.abc import Sequence

import numpy as np

from drsim.arrays import Ints, Seeds
from drsim.car.car import CarBatch
from drsim.car.conditions import Conditions, Disturbances, Realism
from drsim.sensing.observations import Observations


class EpisodeDraws:
    """Draws for the episodes of all cars; `racers` of one group meet the same traffic."""

    def __init__(
        self,
        num_cars: int,
        seed: int,
        racers: int,
        realism: Realism,
        *,
        traffic: bool,
        randomizes: bool,
    ) -> None:
        self.disturbances = Disturbances(num_cars)
        self._seed = seed
        self._racers = racers
        self._realism = realism
        self._traffic = traffic
        self._randomizes = randomizes
        self._disturbs = realism != Realism()
        self._varies_cars = False
        self._begun: Ints = np.zeros(num_cars, np.int64)

    def seeds(self, cars: Ints) -> Seeds:
        if not (self._traffic or self._disturbs or self._randomizes):
            return np.zeros(len(cars), np.uint64)  # nothing is drawn
        groups = cars // self._racers
        seeds = [
            np.random.SeedSequence([self._seed, group, count]).generate_state(1, np.uint64)[0]
            for group, count in zip(groups.tolist(), self._begun[cars].tolist(), strict=True)
        ]
        self._begun[cars] += 1
        return np.array(seeds, np.uint64)

    def begin(
        self,
        cars: Ints,
        seeds: Seeds,
        conditions: Conditions | Sequence[Conditions] | None,
        observations: Observations,
        batch: CarBatch,
    ) -> None:
        """Draw lights, colours, camera and car of new episodes, and put them into effect.

        Raises:
            ValueError: Not k conditions, or their latency is too long.
        """
        racers = cars % self._racers
        if self._randomizes:
            for car, *key in zip(cars.tolist(), seeds.tolist(), racers.tolist(), strict=True):
                random = np.random.Generator(np.random.Philox(key=np.array(key, np.uint64)))
                observations.draw(car, random)
        if conditions is None and not self._disturbs:
            return
        if conditions is None:
            keys = zip(seeds.tolist(), racers.tolist(), strict=True)
            each = [self._realism.draw(seed, racer) for seed, racer in keys]
        else:
            each = [conditions] * len(cars) if isinstance(conditions, Conditions) else [*conditions]
            if len(each) != len(cars):
                raise ValueError(f"There are {len(each)} conditions for {len(cars)} episodes.")
            self._disturbs = True  # the next episode must not keep these
        for car, drawn in zip(cars.tolist(), each, strict=True):
            self.disturbances.begin(car, drawn)
            observations.light(car, drawn)
        self._varies_cars = self._varies_cars or any(drawn.changes_car for drawn in each)
        if self._varies_cars:
            batch.vary(cars, self.disturbances.variation)

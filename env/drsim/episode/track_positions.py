"""Where the cars are on their tracks, and how many wheels are on the road."""

from collections.abc import Sequence

import numpy as np

from drsim.arrays import Floats, Ints
from drsim.car.car import CarBatch
from drsim.episode.placing import JUMP_M, without_jump
from drsim.track.polyline import Location
from drsim.track.track import Track


class TrackPositions:
    """Places of all cars, each on the track in its own driving direction.

    Attributes:
        where: Rows that were handed out stay as they are.
        along_m: Without jumps to neighbouring stretches. Shape (n,).
    """

    where: Location
    wheels_on: Ints

    def __init__(self, tracks: Sequence[Track], backward: Ints, cars: CarBatch) -> None:
        self._tracks = tracks
        self._backward = backward
        self._cars = cars
        self.along_m: Floats = np.zeros(len(backward))
        self._look()

    def refresh(self) -> None:
        """Find all cars; one that stands still stays at its place."""
        stands = (self._cars.front_xy == self._seen_xy).all(axis=1)
        self._look()
        along_m = self.where.distance_m.copy()
        along_m[stands] = self.along_m[stands]
        for car in np.flatnonzero(np.abs(along_m - self.along_m) > JUMP_M):
            track = self._tracks[self._backward[car]]
            along_m[car] = without_jump(
                track, self._cars.front_xy[car], along_m[car], self.along_m[car]
            )
        self.along_m = along_m

    def refresh_placed(self, cars: Ints) -> None:
        self._seen_xy[cars] = self._cars.front_xy[cars]
        self.where = Location._make(column.copy() for column in self.where)
        self.wheels_on = self.wheels_on.copy()
        self.wheels_on[cars] = self._tracks[0].on_road(self._cars.wheel_xy[cars]).sum(axis=1)
        for direction, track in enumerate(self._tracks):
            self._scatter(cars[self._backward[cars] == direction], track)
        self.along_m[cars] = self.where.distance_m[cars]

    def _look(self) -> None:
        self._seen_xy = self._cars.front_xy.copy()
        self.where = self._tracks[0].locate(self._cars.front_xy)
        self.wheels_on = self._tracks[0].on_road(self._cars.wheel_xy).sum(axis=1)
        if self._backward.any():
            self._scatter(np.flatnonzero(self._backward), self._tracks[1])

    def _scatter(self, cars: Ints, track: Track) -> None:
        if len(cars):
            where = track.locate(self._cars.front_xy[cars])
            for known, column in zip(self.where, where, strict=True):
                known[cars] = column

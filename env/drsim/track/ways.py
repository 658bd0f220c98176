"""The ways that the cars of a simulation can drive: each track in both directions."""

from collections.abc import Iterator, Sequence

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.track.track import Track


class Ways:
    """The ways that cars can drive, two on each track, and which one each car drives.

    Attributes:
        tracks: Each as given, then the other way round: 2k and 2k + 1 are one road.
        way: Index into them. Shape (n,).
        road: Index into the tracks as given. Shape (n,).
        length_m: Of the lap. Shape (n,).
        closed: Whether it is a loop. Shape (n,).
    """

    def __init__(self, tracks: Sequence[Track], num_cars: int) -> None:
        self.tracks = tuple(way for track in tracks for way in (track, track.reversed()))
        self.way: Ints = np.zeros(num_cars, np.int64)
        self.road: Ints = np.zeros(num_cars, np.int64)
        self.length_m: Floats = np.full(num_cars, tracks[0].length_m)
        self.closed: Bools = np.full(num_cars, tracks[0].closed)

    def choose(self, cars: Ints, track: int | Ints, reverse: bool | Bools) -> None:
        self.road[cars] = track
        self.way[cars] = 2 * self.road[cars] + np.asarray(reverse, np.int64)
        for k, way in self.groups(cars):
            self.length_m[k], self.closed[k] = way.length_m, way.closed

    def of(self, car: int) -> Track:
        return self.tracks[int(self.way[car])]

    def groups(self, cars: Ints) -> Iterator[tuple[Ints, Track]]:
        """Those of the cars that drive each way, with its track."""
        chosen = self.way[cars]
        for k in np.unique(chosen):
            yield cars[chosen == k], self.tracks[k]

    def on_road(self, cars: Ints, xy: Floats) -> Ints:
        """How many of each car's points lie on its road. Shape (k, m, 2) to (k,)."""
        found = np.empty(len(cars), np.int64)
        roads = self.road[cars]
        for k in np.unique(roads):
            mine = roads == k
            found[mine] = self.tracks[2 * k].on_road(xy[mine]).sum(axis=1)
        return found

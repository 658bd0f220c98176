"""Places on the lap: where cars are put, and how they keep their own stretch of the track."""

from collections.abc import Sequence

import numpy as np

from drsim.arrays import Floats, Ints
from drsim.track.track import INNER, LANES, OUTER, Lane, Track

_PARKED_BESIDE_M = 0.3
"""How far outside the rectangle around the road a racer is parked that has finished. Right beside
the border it could stand on a neighbouring stretch of the track."""

JUMP_M = 1.0
"""No car drives this far in one step (the fastest drives 0.24 m)."""

_SAMPLES = 81
"""Places that are tried, from `JUMP_M` behind to as far ahead: one every 2.5 cm."""


class Placing:
    """Poses on the lanes of a track, for cars of both driving directions.

    Attributes:
        tracks: The track as given, and reversed.
        backward: Index of each car's own into `tracks`; a live array. Shape (n,).
    """

    def __init__(self, tracks: Sequence[Track], backward: Ints) -> None:
        self.tracks = tracks
        self.backward = backward

    def on(self, cars: Ints, fraction: Floats, lane: Lane = "center") -> Floats:
        """Poses on one lane, each in the driving direction of its car.

        `fraction` is where on the lap of its own direction each car is, 0 .. 1. Shape (k,). Poses
        are x and y in metres and yaw in radians. Shape (k, 3).
        """
        backward = self.backward[cars]
        if not backward.any():
            return self.tracks[0].pose_at(fraction * self.tracks[0].length_m, lane)
        poses = np.empty((len(cars), 3))
        for direction, track in enumerate(self.tracks):
            chosen = backward == direction
            if chosen.any():
                poses[chosen] = track.pose_at(fraction[chosen] * track.length_m, lane)
        return poses

    def on_each(self, cars: Ints, fraction: Floats, lanes: Ints) -> Floats:
        """Poses like those of `on`, each on a lane of its own, by index. Shape (k, 3)."""
        poses = np.empty((len(cars), 3))
        for lane, name in enumerate(LANES):
            chosen = lanes == lane
            if chosen.any():
                poses[chosen] = self.on(cars[chosen], fraction[chosen], name)
        return poses

    def nearer_lane(self, cars: Ints, fraction: Floats, xy: Floats) -> Ints:
        """Which of inner and outer lane, by index, is nearer to a point. Shape (k,).

        `xy` are the points, metres. Shape (k, 2). The rest is as in `on`.
        """
        to_inner_m, to_outer_m = (
            np.hypot(*(self.on(cars, fraction, lane)[:, :2] - xy).T) for lane in LANES[1:]
        )
        return np.where(to_inner_m <= to_outer_m, INNER, OUTER)

    def aside(self, cars: Ints, fraction: Floats) -> Floats:
        """Poses outside the rectangle around the road, where nobody drives. Shape (k, 3)."""
        poses = self.on(cars, fraction)
        x_min, y_min, x_max, y_max = self.tracks[0].bounds
        low, high = np.array([x_min, y_min]), np.array([x_max, y_max])
        for pose in poses:
            outwards_m = np.stack([pose[:2] - low, high - pose[:2]])
            side, axis = np.unravel_index(outwards_m.argmin(), outwards_m.shape)
            pose[axis] = (low - _PARKED_BESIDE_M, high + _PARKED_BESIDE_M)[side][axis]
        return poses


def fraction_at(progress: Floats, start_fraction: Floats) -> Floats:
    """Where on the lap, 0 .. 1 from waypoint 0, a progress in percent lies. Shape (n,)."""
    return (start_fraction + progress / 100.0) % 1.0


def without_jump(track: Track, xy: Floats, found_m: float, before_m: float) -> float:
    """Distance along the centre line, unless it belongs to a neighbouring stretch of the track.

    The nearest point of the whole line may lie on another stretch that passes nearby. If a car
    seems to have jumped there in one step, its place is searched again near where it was.

    Returns:
        `found_m`, or the distance nearest to `xy` within `JUMP_M` of `before_m`, to 2.5 cm.
    """
    gap_m = found_m - before_m
    if track.closed:
        gap_m = (gap_m + track.length_m / 2) % track.length_m - track.length_m / 2
    if abs(gap_m) <= JUMP_M:
        return found_m
    nearby_m = before_m + np.linspace(-JUMP_M, JUMP_M, _SAMPLES)
    away_m = np.hypot(*(track.pose_at(nearby_m)[:, :2] - xy).T)
    nearest_m = float(nearby_m[np.argmin(away_m)])
    if track.closed:
        return nearest_m % track.length_m
    return min(max(nearest_m, 0.0), track.length_m)

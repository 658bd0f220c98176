"""Where on the lap cars are put, and how they keep their own stretch."""

from collections.abc import Sequence

import numpy as np

from drsim.arrays import Floats, Ints
from drsim.track.track import INNER, LANES, OUTER, Lane, Track

_PARKED_BESIDE_M = 0.3
JUMP_M = 1.0
"""No car drives this far in one step."""

_SAMPLES = 81


class Placing:
    """Poses on the lanes of a track, for both driving directions."""

    def __init__(self, tracks: Sequence[Track], backward: Ints) -> None:
        self.tracks = tracks
        self.backward = backward

    def on(self, cars: Ints, fraction: Floats, lane: Lane = "center") -> Floats:
        """Poses on one lane in driving direction: metres and radians. Shape (k, 3).

        `fraction` is of the lap in the car's own direction.
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
        poses = np.empty((len(cars), 3))
        for lane, name in enumerate(LANES):
            chosen = lanes == lane
            if chosen.any():
                poses[chosen] = self.on(cars[chosen], fraction[chosen], name)
        return poses

    def nearer_lane(self, cars: Ints, fraction: Floats, xy: Floats) -> Ints:
        """Inner or outer lane, by index."""
        to_inner_m, to_outer_m = (
            np.hypot(*(self.on(cars, fraction, lane)[:, :2] - xy).T) for lane in LANES[1:]
        )
        return np.where(to_inner_m <= to_outer_m, INNER, OUTER)

    def aside(self, cars: Ints, fraction: Floats) -> Floats:
        poses = self.on(cars, fraction)
        x_min, y_min, x_max, y_max = self.tracks[0].bounds
        low, high = np.array([x_min, y_min]), np.array([x_max, y_max])
        for pose in poses:
            outwards_m = np.stack([pose[:2] - low, high - pose[:2]])
            side, axis = np.unravel_index(outwards_m.argmin(), outwards_m.shape)
            pose[axis] = (low - _PARKED_BESIDE_M, high + _PARKED_BESIDE_M)[side][axis]
        return poses


def fraction_at(progress: Floats, start_fraction: Floats) -> Floats:
    return (start_fraction + progress / 100.0) % 1.0


def without_jump(track: Track, xy: Floats, found_m: float, before_m: float) -> float:
    """Distance along the centre line, unless it belongs to a neighbouring stretch of the track.

    After such a jump in one step, the nearest place within `JUMP_M`, to 2.5 cm.
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

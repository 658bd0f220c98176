"""Whether a car finds a way past the objects on its track."""

import numpy as np

from drsim.arrays import Floats
from drsim.race.objects import Objects
from drsim.race.solids import SHAPES
from drsim.track.track import Track

_CAR_M = SHAPES["race_car"].footprint_m

_STEP_M, _WIDEST_M = 0.02, 3.0
"""Of ways beside the centre line: spacing and the farthest."""


def closed_at_m(track: Track, objects: Objects) -> Floats:
    """Where along the lap objects first leave a car no way, metres; NaN for nowhere.

    A way is straight ahead, as wide as the car, with its middle on the road.
    """
    ways_m = np.arange(-_WIDEST_M, _WIDEST_M + _STEP_M, _STEP_M)
    found = np.full(len(objects.distance_m), np.nan)
    side_m = np.where(objects.left_of_center, 1.0, -1.0) * objects.from_center_m
    apart_m = (objects.footprint_m[:, 1] + _CAR_M[1]) / 2
    for car, places_m in enumerate(objects.distance_m):
        x, y, yaw_rad = track.pose_at(places_m).T[:, :, None]
        points = np.stack([x - np.sin(yaw_rad) * ways_m, y + np.cos(yaw_rad) * ways_m], axis=-1)
        road = track.on_road(points)
        road[:, [0, -1]] = False
        for each in np.argsort(places_m):
            ahead_m = places_m - places_m[each]
            if track.closed:
                ahead_m = ahead_m % track.length_m
            near = (ahead_m >= 0.0) & (ahead_m < objects.footprint_m[each, 0] + _CAR_M[0])
            free = np.abs(ways_m - side_m[car, near, None]) >= apart_m[near, None]
            # Beyond an edge of the road there may be another part of it.
            off_m = ways_m[~road[each]]
            left_m, right_m = off_m[off_m > 0.0].min(), off_m[off_m <= 0.0].max()
            if not (free.all(axis=0) & (right_m < ways_m) & (ways_m < left_m)).any():
                found[car] = places_m[each]
                break
    return found

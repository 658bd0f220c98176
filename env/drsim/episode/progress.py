"""Places on the lap, and how a car keeps its own where two stretches of the track are near."""

import numpy as np

from drsim.arrays import Floats
from drsim.track.track import Track

JUMP_M = 1.0
"""No car drives this far in one step (the fastest drives 0.24 m)."""

_SAMPLES = 81


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

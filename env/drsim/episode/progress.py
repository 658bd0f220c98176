"""Progress round the lap, from where a car is along the centre line."""

import numpy as np
from numpy.typing import NDArray

from drsim.jit import kernel
from drsim.track.track import Track

Floats = NDArray[np.float64]

JUMP_M = 1.0
"""No car drives this far in one step (the fastest drives 0.24 m)."""

_SAMPLES = 81


@kernel
def advance_progress(previous: Floats, fraction: Floats, start_fraction: Floats) -> Floats:
    """Progress after a step, in percent of a lap counted from the start of the episode.

    Crossing the finish line forwards ends at exactly 100, backing over the start line gives
    negative values, and a car that has just finished a lap begins again from 0. Source: the
    reference simulator's rules, in their order.

    Args:
        previous: Progress of the step before, 0 at the start and after a finished lap. Shape (n,).
        fraction: Where the car is along the centre line, 0 .. 1 from waypoint 0. Shape (n,).
        start_fraction: Where its episode started, likewise. Shape (n,).

    Returns:
        Progress in percent, at most 100. Shape (n,).
    """
    progress = 100.0 * (fraction - start_fraction)
    for car in range(len(progress)):
        if progress[car] <= 0:
            progress[car] += 100
        if previous[car] > progress[car] + 50:
            progress[car] += 100
        if progress[car] > previous[car] + 50:
            progress[car] -= 100
        progress[car] = min(progress[car], 100.0)
    return progress


def fraction_at(progress: Floats, start_fraction: Floats) -> Floats:
    """Where on the lap, 0 .. 1 from waypoint 0, a progress in percent lies. Shape (n,)."""
    return (start_fraction + progress / 100.0) % 1.0


def without_jump(track: Track, xy: Floats, found_m: float, before_m: float) -> float:
    """Distance along the centre line, unless it belongs to a neighbouring stretch of the track.

    The nearest point of the whole line may lie on another stretch that passes nearby. If a car
    seems to have jumped there in one step, its place is searched again near where it was.

    Args:
        track: The track.
        xy: The point in the world, metres. Shape (2,).
        found_m: Distance of the nearest point of the whole line.
        before_m: Distance one step before.

    Returns:
        `found_m`, or the nearest distance within `JUMP_M` of `before_m`, to 2.5 cm.
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

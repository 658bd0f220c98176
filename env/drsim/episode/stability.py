"""Finds cars whose physics failed, by how they moved."""

import math

from drsim.arrays import Bools, Floats
from drsim.jit import kernel

FURTHEST_M = 1.0
"""In a step; the fastest car makes 0.27 m. With infinite numbers, the physics engine puts a car to
the origin.
"""

HIGHEST_M = 0.5
"""A camera is fixed 0.13 m above the ground."""


@kernel
def mark_unstable(
    xy: Floats, came_from: Floats, yaw_rad: Floats, lens_pos: Floats, unstable: Bools
) -> bool:
    """Mark cars that moved in a way that no car can, in place; whether there are any."""
    any_unstable = False
    for i in range(len(unstable)):
        moved_m = max(abs(xy[i, 0] - came_from[i, 0]), abs(xy[i, 1] - came_from[i, 1]))
        # Written so that NaN is unstable, too.
        stable = moved_m < FURTHEST_M and abs(lens_pos[i, 2]) < HIGHEST_M
        unstable[i] = not (stable and math.isfinite(xy[i, 0] + xy[i, 1] + yaw_rad[i]))
        any_unstable = any_unstable or unstable[i]
    return any_unstable

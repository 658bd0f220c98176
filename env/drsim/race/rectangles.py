"""Whether rectangles on the floor overlap."""

import math

import numpy as np
from numpy.typing import NDArray

from drsim.jit import kernel

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@kernel
def overlaps(
    xy: Floats,
    yaw_rad: Floats,
    size_m: Floats,
    other_xy: Floats,
    other_yaw_rad: Floats,
    other_size_m: Floats,
    out: Bools,
) -> None:
    """Compare one rectangle with k others, n times over; touching is no overlap.

    Args:
        xy: Centres in metres. Shape (n, 2).
        yaw_rad: Directions of their lengths. Shape (n,).
        size_m: Length and width, of all of them. Shape (2,).
        other_xy: Centres of the others. Shape (n, k, 2).
        other_yaw_rad: Their directions. Shape (n, k).
        other_size_m: Their lengths and widths. Shape (k, 2).
        out: Written: whether they overlap. Shape (n, k).
    """
    length_m, width_m = 0.5 * size_m[0], 0.5 * size_m[1]
    for i in range(out.shape[0]):
        cos, sin = math.cos(yaw_rad[i]), math.sin(yaw_rad[i])
        for k in range(out.shape[1]):
            half_m, across_m = 0.5 * other_size_m[k, 0], 0.5 * other_size_m[k, 1]
            dx, dy = other_xy[i, k, 0] - xy[i, 0], other_xy[i, k, 1] - xy[i, 1]
            reach_m = math.hypot(length_m, width_m) + math.hypot(half_m, across_m)
            # Written so that a distance that is no number overlaps nothing.
            if not dx * dx + dy * dy < reach_m * reach_m:
                out[i, k] = False
                continue
            # Two rectangles are apart when one of their four axes separates their shadows on it.
            turn = other_yaw_rad[i, k] - yaw_rad[i]
            c, s = abs(math.cos(turn)), abs(math.sin(turn))
            other_cos, other_sin = math.cos(other_yaw_rad[i, k]), math.sin(other_yaw_rad[i, k])
            out[i, k] = (
                abs(cos * dx + sin * dy) < length_m + half_m * c + across_m * s
                and abs(cos * dy - sin * dx) < width_m + half_m * s + across_m * c
                and abs(other_cos * dx + other_sin * dy) < half_m + length_m * c + width_m * s
                and abs(other_cos * dy - other_sin * dx) < across_m + length_m * s + width_m * c
            )

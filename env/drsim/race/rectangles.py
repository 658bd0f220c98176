"""Whether rectangles on the floor overlap."""

import math

import numpy as np

from drsim.arrays import Bools, Floats
from drsim.jit import kernel

Rectangles = tuple[Floats, Floats, Floats]
"""Centres in metres, shape (n, 2) or (n, k, 2); directions, (n,) or (n, k); lengths and widths,
(2,) or (k, 2).
"""


@kernel
def overlaps(one: Rectangles, others: Rectangles) -> Bools:
    """Compare n rectangles with k others each; touching is not overlapping. Shape (n, k).

    Two are apart when one of their four axes separates their shadows on it.
    """
    one_xy, one_yaw_rad, one_size_m = one
    other_xy, other_yaw_rad, other_size_m = others
    out: Bools = np.empty(other_yaw_rad.shape, np.bool_)
    length_m, width_m = 0.5 * one_size_m[0], 0.5 * one_size_m[1]
    for i in range(out.shape[0]):
        yaw_rad = one_yaw_rad[i]
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        for k in range(out.shape[1]):
            half_m, across_m = 0.5 * other_size_m[k, 0], 0.5 * other_size_m[k, 1]
            dx, dy = other_xy[i, k, 0] - one_xy[i, 0], other_xy[i, k, 1] - one_xy[i, 1]
            reach_m = math.hypot(length_m, width_m) + math.hypot(half_m, across_m)
            # Written so that a distance that is NaN overlaps nothing.
            if not dx * dx + dy * dy < reach_m * reach_m:
                out[i, k] = False
                continue
            other_rad = other_yaw_rad[i, k]
            c, s = abs(math.cos(other_rad - yaw_rad)), abs(math.sin(other_rad - yaw_rad))
            other_cos, other_sin = math.cos(other_rad), math.sin(other_rad)
            out[i, k] = (
                abs(cos * dx + sin * dy) < length_m + half_m * c + across_m * s
                and abs(cos * dy - sin * dx) < width_m + half_m * s + across_m * c
                and abs(other_cos * dx + other_sin * dy) < half_m + length_m * c + width_m * s
                and abs(other_cos * dy - other_sin * dx) < across_m + length_m * s + width_m * c
            )
    return out

"""Whether rectangles on the floor overlap."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drsim.jit import kernel

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Rectangles(NamedTuple):
    """Rectangles, n of one size, or k of different sizes around each of n.

    Attributes:
        xy: Centres in metres. Shape (n, 2) or (n, k, 2).
        yaw_rad: Directions of their lengths. Shape (n,) or (n, k).
        size_m: Lengths and widths. Shape (2,) or (k, 2).
    """

    xy: Floats
    yaw_rad: Floats
    size_m: Floats


@kernel
def overlaps(one: Rectangles, others: Rectangles) -> Bools:
    """Compare one rectangle with k others, n times over; touching is not overlapping.

    Two rectangles are apart when one of their four axes separates their shadows on it.

    Args:
        one: n rectangles of one size.
        others: k around each of them.

    Returns:
        Whether they overlap. Shape (n, k).
    """
    out: Bools = np.empty(others.yaw_rad.shape, np.bool_)
    length_m, width_m = 0.5 * one.size_m[0], 0.5 * one.size_m[1]
    for i in range(out.shape[0]):
        yaw_rad = one.yaw_rad[i]
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        for k in range(out.shape[1]):
            half_m, across_m = 0.5 * others.size_m[k, 0], 0.5 * others.size_m[k, 1]
            dx, dy = others.xy[i, k, 0] - one.xy[i, 0], others.xy[i, k, 1] - one.xy[i, 1]
            reach_m = math.hypot(length_m, width_m) + math.hypot(half_m, across_m)
            # Written so that a distance that is NaN overlaps nothing.
            if not dx * dx + dy * dy < reach_m * reach_m:
                out[i, k] = False
                continue
            other_rad = others.yaw_rad[i, k]
            c, s = abs(math.cos(other_rad - yaw_rad)), abs(math.sin(other_rad - yaw_rad))
            other_cos, other_sin = math.cos(other_rad), math.sin(other_rad)
            out[i, k] = (
                abs(cos * dx + sin * dy) < length_m + half_m * c + across_m * s
                and abs(cos * dy - sin * dx) < width_m + half_m * s + across_m * c
                and abs(other_cos * dx + other_sin * dy) < half_m + length_m * c + width_m * s
                and abs(other_cos * dy - other_sin * dx) < across_m + length_m * s + width_m * c
            )
    return out

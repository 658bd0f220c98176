"""Which cells of a grid lie on the road: those with an odd number of borders to their left."""

import math

import numpy as np

from drsim.arrays import Bools, Floats, Singles
from drsim.jit import kernel


def sign_off_road(inner: Floats, outer: Floats, closed: bool, distance: Singles) -> None:
    """Make distances negative off the road. Borders in cells, each vertex once."""
    crossed = np.zeros(distance.shape, np.bool_)
    for ring in (inner, outer) if closed else (np.concatenate([outer, inner[::-1]]),):
        _cross(ring, crossed)
    _sign(crossed, distance)


@kernel
def _cross(ring: Floats, crossed: Bools) -> None:
    rows, columns = crossed.shape
    for i in range(len(ring)):
        ax, ay = ring[i - 1]
        bx, by = ring[i]
        low, high = min(ay, by), max(ay, by)
        for row in range(max(math.ceil(low), 0), min(math.ceil(high), rows)):
            column = max(math.ceil(ax + (row - ay) / (by - ay) * (bx - ax)), 0)
            if column < columns:
                crossed[row, column] = not crossed[row, column]


@kernel
def _sign(crossed: Bools, distance: Singles) -> None:
    rows, columns = crossed.shape
    for row in range(rows):
        on_road = False
        for column in range(columns):
            on_road ^= crossed[row, column]
            if not on_road:
                distance[row, column] = -distance[row, column]

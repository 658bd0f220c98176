"""Which cells of a grid lie on the road: an odd number of borders to their left."""

import math

from drsim.arrays import Bools, Floats, Singles
from drsim.jit import kernel


@kernel
def cross_ring(ring: Floats, crossed: Bools) -> None:
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
def sign_off_road(crossed: Bools, distance: Singles) -> None:
    rows, columns = crossed.shape
    for row in range(rows):
        on_road = False
        for column in range(columns):
            on_road ^= crossed[row, column]
            if not on_road:
                distance[row, column] = -distance[row, column]

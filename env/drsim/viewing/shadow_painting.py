"""The light that shadows leave on the ground."""

import math

import numpy as np

from drsim.arrays import Floats, Singles
from drsim.jit import kernel

_SHADE = 0.56
_FURTHEST_M = 60.0
"""Depth of shadows."""

SHADOW_X, SHADOW_Y, SHADOW_COS, SHADOW_SIN, SHADOW_LENGTH, SHADOW_WIDTH, SHADOW_HEIGHT = range(7)
"""Columns: middle, direction, half length and width, height, metres."""


@kernel
def shade(
    shadows: Floats,
    leaning: tuple[float, float],
    pos: tuple[float, float, float],
    step: tuple[float, float],
    row_parts: tuple[Floats, Floats, Floats],
    light: Singles,
) -> None:
    """The light on the ground in rows of a picture; `leaning` is per metre of height."""
    directions, depths, below = row_parts
    for row in range(len(light)):
        light[row] = np.float32(1.0)
        depth = depths[row]
        if below[row] > 0.0 and depth < _FURTHEST_M:
            at = (
                (pos[0] + depth * directions[row, 0], pos[1] + depth * directions[row, 1]),
                (depth * step[0], depth * step[1]),
            )
            for k in range(len(shadows)):
                _shade_row(shadows, k, leaning, at, light[row])


@kernel
def _shade_row(
    shadows: Floats,
    k: int,
    leaning: tuple[float, float],
    at: tuple[tuple[float, float], tuple[float, float]],
    light: Singles,
) -> None:
    middle_x, middle_y, cos, sin = shadows[k, 0], shadows[k, 1], shadows[k, 2], shadows[k, 3]
    half_length, half_width, height = shadows[k, 4], shadows[k, 5], shadows[k, 6]
    reach = half_length + half_width + 1.3 * height + 0.1
    (first_x, first_y), right = at
    # The pixels of the row that are near enough lie around the one that is nearest.
    square = right[0] * right[0] + right[1] * right[1] + 1e-18
    to_x, to_y = middle_x - first_x, middle_y - first_y
    nearest = (to_x * right[0] + to_y * right[1]) / square
    away_x, away_y = to_x - nearest * right[0], to_y - nearest * right[1]
    rest = reach * reach - away_x * away_x - away_y * away_y
    if rest <= 0.0:
        return
    around = math.sqrt(rest / square)
    begin = int(min(max(nearest - around, 0.0), float(len(light))))
    end = int(min(max(nearest + around + 1.0, 0.0), float(len(light))))
    for pixel in range(begin, end):
        x = first_x + pixel * right[0] - middle_x
        y = first_y + pixel * right[1] - middle_y
        darkest = 0.0
        for layer in range(4):
            part = layer / 3.0
            px, py = x - part * height * leaning[0], y - part * height * leaning[1]
            along = abs(px * cos + py * sin) - half_length * (1.0 - 0.25 * part)
            across = abs(py * cos - px * sin) - half_width * (1.0 - 0.20 * part)
            outside = math.hypot(max(along, 0.0), max(across, 0.0)) + min(max(along, across), 0.0)
            soft = 0.016 + 0.11 * part * height
            darkest = max(darkest, min(max(0.5 - outside / (2.0 * soft), 0.0), 1.0))
        along = abs(x * cos + y * sin) - half_length
        across = abs(y * cos - x * sin) - half_width
        outside = math.hypot(max(along, 0.0), max(across, 0.0))
        near = max(1.0 - outside / 0.07, 0.0)
        light[pixel] *= (1.0 - _SHADE * darkest) * (1.0 - 0.3 * near * near)

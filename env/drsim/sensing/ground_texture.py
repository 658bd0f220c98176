"""The grain of a painted ground: short fibres strewn over a tile."""

import math
import zlib

import numpy as np
from numpy.typing import NDArray

from drsim.jit import kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_TILE = 512
"""Side of the grain, which repeats over the ground, in texels."""

_STROKE_M = 0.010
"""Length of one fibre of the grain. Source: estimated on frames of the reference simulator."""


def grain_tile(world: str, texel_m: float) -> Singles:
    """Fibres strewn over a tile that joins itself at its edges: mean 0, deviation 1.

    The seed is the world's name, so that a world looks the same on every machine and in every run.
    """
    random = np.random.default_rng(zlib.crc32(world.encode()))
    count = _TILE * _TILE // 8
    fibres = random.random((count, 3))
    shades = random.standard_normal(count)
    tile = np.zeros((_TILE, _TILE))
    _strew(fibres, shades, _STROKE_M / texel_m, tile)
    even: Singles = ((tile - tile.mean()) / tile.std()).astype(np.float32)
    return even


@kernel
def _strew(fibres: Floats, shades: Floats, length: float, tile: Floats) -> None:
    """Add short straight strokes at places and angles given as fractions of the tile and a turn."""
    side = tile.shape[0]
    dots = math.ceil(2.0 * length) + 1
    for i in range(len(fibres)):
        angle = 2.0 * math.pi * fibres[i, 2]
        for dot in range(dots):
            out = length * (dot / (dots - 1.0) - 0.5)
            x = fibres[i, 0] * side + out * math.cos(angle)
            y = fibres[i, 1] * side + out * math.sin(angle)
            column, row = math.floor(x), math.floor(y)
            right, up = x - column, y - row
            tile[row % side, column % side] += shades[i] * (1.0 - right) * (1.0 - up)
            tile[row % side, (column + 1) % side] += shades[i] * right * (1.0 - up)
            tile[(row + 1) % side, column % side] += shades[i] * (1.0 - right) * up
            tile[(row + 1) % side, (column + 1) % side] += shades[i] * right * up

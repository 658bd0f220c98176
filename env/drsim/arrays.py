"""Types of arrays and of tuples by what they hold, so that signatures are short."""

import numpy as np
from numpy.typing import NDArray

Single = np.float32
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
HalfWords = NDArray[np.uint16]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Words = NDArray[np.uint32]
Seeds = NDArray[np.uint64]
Cuboids = NDArray[np.void]
"""Arrays of `drsim.race.solids.CUBOID`."""

RGB = tuple[float, float, float]
Vector = tuple[float, float, float]

LensParts = tuple[Floats, Floats, float, float]
"""Of n lenses: positions, columns forward, left and up, focal length in pixels, and what is added
to a grey before its fraction is cut off.
"""

"""Array types by what they hold, so that signatures are short."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Seeds = NDArray[np.uint64]
Cuboids = NDArray[np.void]
"""Arrays of `drsim.race.solids.CUBOID`."""

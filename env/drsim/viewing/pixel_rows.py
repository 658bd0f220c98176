"""Which way the rows of a picture look, and where they meet the ground."""

from typing import NamedTuple

import numpy as np

from drsim.arrays import Floats

Vector = tuple[float, float, float]
LensParts = tuple[Vector, Vector, Vector, Vector, float]
"""Position in metres, forward, left and up, focal length in pixels."""


class PixelRows(NamedTuple):
    """Rows of pixels of a lens that does not lean sideways.

    Attributes:
        directions: Of first pixels. Shape (n, 3).
        depths: Of the ground, along the lens. Shape (n,).
        below: The part below the horizon, 0 to 1. Shape (n,).
    """

    directions: Floats
    depths: Floats
    below: Floats
    step: tuple[float, float]

    def part(self, first: int, last: int) -> "PixelRows":
        rows = slice(first, last)
        return PixelRows(self.directions[rows], self.depths[rows], self.below[rows], self.step)


def pixel_rows(lens: LensParts, size: tuple[int, int]) -> PixelRows:
    pos, forward, to_left, to_up, focal_px = lens
    rows, columns = size
    left = (0.5 * columns - 0.5) / focal_px
    up = (0.5 * rows - (np.arange(rows) + 0.5)) / focal_px
    directions = np.stack(
        [
            forward[0] + left * to_left[0] + up * to_up[0],
            forward[1] + left * to_left[1] + up * to_up[1],
            forward[2] + up * to_up[2],
        ],
        axis=1,
    )
    # The row in which the ground ends is blended with the horizon.
    below = np.clip(0.5 - directions[:, 2] * focal_px, 0.0, 1.0)
    depths = pos[2] / -np.minimum(directions[:, 2], -0.4 / focal_px)
    return PixelRows(directions, depths, below, (-to_left[0] / focal_px, -to_left[1] / focal_px))

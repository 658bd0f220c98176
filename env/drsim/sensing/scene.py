"""A track as the camera sees it: the painted ground in shrinking copies, walls and sky."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Bytes, Singles
from drsim.jit import kernel
from drsim.sensing.ground import Grid, paint_ground
from drsim.sensing.raycast import Backdrop, Ground
from drsim.track.appearance import Look, look_of
from drsim.track.track import Track

Words = NDArray[np.uint32]
Pairs = NDArray[np.uint16]
Ints32 = NDArray[np.int32]

FINEST_TEXEL_M = 0.003
"""Side of a texel of the full-size ground picture, on tracks small enough for it."""

MOST_TEXELS = 20_000_000
"""Upper limit of the full-size picture. With its smaller copies it then takes 54 MB."""

_LEVELS = 8
"""Copies of the ground picture, each half as large as the one before."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What `camera.render` looks at. Build it once per track with `build_scene`.

    Attributes:
        texels: All copies of the ground picture, one after the other, row by row. A word holds
            the greys of a texel and of its neighbours: itself in bits 0..7, the one above (greater
            y) in 8..15, the one to the right in 16..23, above right in 24..31, so that blending
            four texels takes one memory access. Neighbouring words overlap by half.
        levels: Of each copy: index of its first word, words per row, columns, rows.
            Shape (levels, 4).
        x_m: World x of the left edge of the picture.
        y_m: World y of its lower edge.
        texel_m: Side of a texel of the first copy; it doubles from copy to copy.
        walls_m: Inner faces of the walls: least x, greatest x, least y, greatest y. Shape (4,).
        wall_height_m: Height of the walls above the ground.
        wall_greys: Greys of the walls, in the order of `walls_m`. Shape (4,).
        sky_grey: Grey of the sky.
    """

    texels: Words
    levels: Ints32
    x_m: float
    y_m: float
    texel_m: float
    walls_m: Singles
    wall_height_m: float
    wall_greys: Singles
    sky_grey: float

    def __deepcopy__(self, _: dict[int, Any]) -> "Scene":
        """Itself: nothing ever changes it, and it is large."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Its fields, with the words apart: their overlap would be lost, at twice the size."""
        state = {**self.__dict__, "texels": self.pairs()}
        for cached in ("ground", "picture", "backdrop"):
            state.pop(cached, None)
        return state

    def pairs(self) -> Pairs:
        """The words without their overlap: a texel in the low byte, the one above in the high."""
        return np.append(self.texels & 0xFFFF, self.texels[-1:] >> 16).astype(np.uint16)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Lay the words over each other again."""
        self.__dict__.update({**state, "texels": _words(state["texels"])})

    @cached_property
    def picture(self) -> tuple[Any, ...]:
        """The ground picture as `raycast.draw` needs it."""
        return tuple(Ground(self.texels, self.levels, self.x_m, self.y_m, self.texel_m))

    @cached_property
    def backdrop(self) -> tuple[Any, ...]:
        """Walls and sky in the usual light, likewise."""
        backdrop = Backdrop(
            self.walls_m,
            self.wall_height_m,
            wall_greys=self.wall_greys[None],
            sky_greys=np.array([self.sky_grey], np.float32),
            palettes=np.empty((0, 256), np.uint8),
        )
        return tuple(backdrop)

    @cached_property
    def ground(self) -> Bytes:
        """Greys of the full-size ground picture. Shape (rows, columns); row 0 has the least y."""
        return self.level(0)

    def level(self, index: int) -> Bytes:
        """Greys of one copy of the ground picture. Shape (rows, columns)."""
        first, pitch, columns, rows = self.levels[index]
        words = self.texels[first : first + pitch * rows].reshape(rows, pitch)[:, :columns]
        return (words & 0xFF).astype(np.uint8)


def build_scene(track: Track, look: Look | None = None) -> Scene:
    """Paint a track: 18 MB for a track of 18 m, never more than 55 MB. Takes 0.1 to 0.7 s.

    Without `look` it gets the appearance of the world of the same name.
    """
    look = look or look_of(track.name)
    border = np.concatenate([track.inner, track.outer])
    low = border.min(axis=0) - look.walls.margin_m
    high = border.max(axis=0) + look.walls.margin_m
    size_m = high - low
    texel_m = max(FINEST_TEXEL_M, float(np.sqrt(size_m.prod() / MOST_TEXELS)))
    columns, rows = np.ceil(size_m / texel_m).astype(int)
    grid = Grid(float(low[0]), float(low[1]), texel_m, int(columns), int(rows))

    picture = paint_ground(track, look, grid)
    pictures = [picture]
    for _ in range(_LEVELS - 1):
        picture = _halved(picture)
        pictures.append(picture)
    levels = np.empty((len(pictures), 4), np.int32)
    used = 0
    for index, picture in enumerate(pictures):
        levels[index] = used, _pitch(picture.shape[1]), picture.shape[1], picture.shape[0]
        used += int(levels[index, 1]) * picture.shape[0]
    pairs = np.zeros(used + 1, np.uint16)
    for (first, pitch, _, rows), picture in zip(levels, pictures, strict=True):
        _pack(picture, pairs[first : first + pitch * rows].reshape(rows, pitch))
    return Scene(
        texels=_words(pairs),
        levels=levels,
        x_m=grid.x_m,
        y_m=grid.y_m,
        texel_m=texel_m,
        walls_m=np.array(look.walls.around(track.bounds), np.float32),
        wall_height_m=look.walls.height_m,
        wall_greys=np.array(look.walls.greys, np.float32),
        sky_grey=look.sky_grey,
    )


def _words(pairs: Pairs) -> Words:
    """Each pair of texels together with the pair that follows it. Shape one less."""
    return np.ndarray(len(pairs) - 1, np.uint32, pairs, strides=(2,))


def _pitch(columns: int) -> int:
    """Words per row for a number of columns, at least one more than there are.

    An odd number of 64-byte cache lines: a walk up the picture then spreads over the whole cache,
    where a pitch near a power of two would use one slot of it again and again (3x slower).
    """
    lines = -(-(columns + 1) // 32)
    return 32 * (lines | 1)


@kernel
def _halved(picture: Bytes) -> Bytes:
    """Every 2 x 2 texels averaged into one; an odd last row or column is averaged with itself."""
    rows, columns = picture.shape
    half = np.empty(((rows + 1) // 2, (columns + 1) // 2), np.uint8)
    for row in range(half.shape[0]):
        low, high = 2 * row, min(2 * row + 1, rows - 1)
        for column in range(half.shape[1]):
            left, right = 2 * column, min(2 * column + 1, columns - 1)
            total = (
                np.int32(picture[low, left])
                + np.int32(picture[low, right])
                + np.int32(picture[high, left])
                + np.int32(picture[high, right])
            )
            half[row, column] = (total + 2) >> 2
    return half


@kernel
def _pack(picture: Bytes, pairs: Pairs) -> None:
    """Write each texel and the one above it side by side; the last row and column are doubled."""
    rows, columns = picture.shape
    for row in range(rows):
        above = min(row + 1, rows - 1)
        for column in range(columns + 1):
            inside = min(column, columns - 1)
            pairs[row, column] = (
                np.int32(picture[row, inside]) | np.int32(picture[above, inside]) << 8
            )

"""A track as the camera sees it: the painted ground in shrinking copies, walls and sky."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import Bytes, Cuboids, Floats, HalfWords, Ints, Ints32, LensParts, Singles, Words
from drsim.car.car import FRONT, CameraModel
from drsim.jit import kernel
from drsim.sensing import cuboids, raycast
from drsim.sensing.ground import Grid, paint_ground
from drsim.sensing.raycast import Backdrop, Ground
from drsim.track.appearance import AMBIENT, LUMA, SUN, Look, look_of
from drsim.track.track import Track

FINEST_TEXEL_M = 0.003
MOST_TEXELS = 20_000_000
"""With smaller copies, 54 MB."""

_LEVELS = 8


@dataclass(frozen=True, eq=False)
class Scene:
    """What `camera.render` looks at; see `build_scene`.

    Attributes:
        texels: All copies, row by row. A word holds the greys of a texel in bits 0..7, of the one
            above (greater y) in 8..15, to the right in 16..23, above right in 24..31, so that
            blending takes one memory access.
        levels: Index of the first word, words per row, columns, rows. Shape (levels, 4).
        x_m: Left edge.
        y_m: Lower edge.
        texel_m: Of the first copy; it doubles.
        walls_m: Inner faces: least x, greatest x, least y, greatest y.
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
        """Itself: nothing ever changes it."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Without the overlap of words, which would be lost, at twice the size."""
        state = {**self.__dict__, "texels": self.pairs()}
        for cached in ("picture", "backdrop"):
            state.pop(cached, None)
        return state

    def pairs(self) -> HalfWords:
        return np.append(self.texels & 0xFFFF, self.texels[-1:] >> 16).astype(np.uint16)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({**state, "texels": _words(state["texels"])})

    @cached_property
    def picture(self) -> tuple[Any, ...]:
        return tuple(Ground(self.texels, self.levels, self.x_m, self.y_m, self.texel_m))

    @cached_property
    def backdrop(self) -> tuple[Any, ...]:
        backdrop = Backdrop(
            self.walls_m,
            self.wall_height_m,
            wall_greys=self.wall_greys[None],
            sky_greys=np.array([self.sky_grey], np.float32),
            palettes=np.empty((0, 256), np.uint8),
        )
        return tuple(backdrop)

    def level(self, index: int) -> Bytes:
        """Row 0 has the least y."""
        first, pitch, columns, rows = self.levels[index]
        words = self.texels[first : first + pitch * rows].reshape(rows, pitch)[:, :columns]
        return (words & 0xFF).astype(np.uint8)


def build_scene(track: Track, look: Look | None = None) -> Scene:
    """Paint a track: 18 to 55 MB, in 0.1 to 0.7 s."""
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
    return _scene(track, look, _words(pairs), levels, grid)


def blank_scene(track: Track) -> Scene:
    """Without the ground, in no time; for simulations that never draw."""
    grid = Grid(0.0, 0.0, 1.0, 0, 0)
    levels = np.zeros((_LEVELS, 4), np.int32)
    return _scene(track, look_of(track.name), np.zeros(1, np.uint32), levels, grid)


def _scene(track: Track, look: Look, texels: Words, levels: Ints32, grid: Grid) -> Scene:
    return Scene(
        texels=texels,
        levels=levels,
        x_m=grid.x_m,
        y_m=grid.y_m,
        texel_m=grid.texel_m,
        walls_m=np.array(look.walls.around(track.bounds), np.float32),
        wall_height_m=look.walls.height_m,
        wall_greys=np.array(look.walls.greys, np.float32),
        sky_grey=look.sky_grey,
    )


def _words(pairs: HalfWords) -> Words:
    return np.ndarray(len(pairs) - 1, np.uint32, pairs, strides=(2,))


def _pitch(columns: int) -> int:
    """An odd number of 64-byte cache lines: near a power of two it would be 3x slower."""
    lines = -(-(columns + 1) // 32)
    return 32 * (lines | 1)


@kernel
def _halved(picture: Bytes) -> Bytes:
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
def _pack(picture: Bytes, pairs: HalfWords) -> None:
    rows, columns = picture.shape
    for row in range(rows):
        above = min(row + 1, rows - 1)
        for column in range(columns + 1):
            inside = min(column, columns - 1)
            pairs[row, column] = (
                np.int32(picture[row, inside]) | np.int32(picture[above, inside]) << 8
            )


def lens_pose(
    body_pos: Floats, body_mat: Floats, camera: CameraModel = FRONT
) -> tuple[Floats, Floats]:
    """Of lenses, given those of base frames."""
    cos, sin = math.cos(camera.pitch_rad), math.sin(camera.pitch_rad)
    tilt = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return body_pos + body_mat @ np.array(camera.mount_m), body_mat @ tilt


class Light(NamedTuple):
    """What the light makes of a scene, for each lens: greys, and light on solids per colour.

    Attributes:
        palettes: Of the greys of the ground. Shape (n, 256).
        sun: On sides that face it. Shape (n, 3).
    """

    palettes: Bytes
    wall_greys: Singles
    sky_greys: Singles
    ambient: Singles
    sun: Singles


def render(
    scene: Scene,
    lens_pos: Floats,
    lens_mat: Floats,
    out: Bytes,
    camera: CameraModel = FRONT,
    *,
    boxes: Cuboids | None = None,
    light: Light | None = None,
    rounding: bool = False,
) -> None:
    """Draw what lenses see, one frame each, without the GIL.

    A lens outside the walls misses the ones it has passed; a pose that is not finite gives a black
    frame. `lens_pos` is in metres, `lens_mat` has columns forward, left, up, and `boxes` the type
    `solids.CUBOID`, shape (n, m). `rounding` is for the reference's stereo frames.

    Raises:
        ValueError: The shapes do not fit together.
    """
    cars = len(lens_pos)
    shapes = lens_pos.shape, lens_mat.shape, out.shape
    if shapes != ((cars, 3), (cars, 3, 3), (cars, camera.rows, camera.columns)):
        raise ValueError(
            f"The shapes {shapes} do not fit n positions, n axes and n frames of "
            f"{camera.rows} x {camera.columns} pixels."
        )
    if boxes is not None and len(boxes) != cars:
        raise ValueError(f"There are boxes for {len(boxes)} lenses, but {cars} lenses.")
    if light is not None and len(light.palettes) != cars:
        raise ValueError(f"There is light for {len(light.palettes)} lenses, but {cars} lenses.")
    lenses = lens_parts(lens_pos, lens_mat, camera, rounding=rounding)
    draw_ground(scene, lenses, out, np.arange(cars), np.zeros(1, np.int64), light)
    if boxes is not None:
        draw_solids(boxes, lenses, out, light)


def lens_parts(
    lens_pos: Floats, lens_mat: Floats, camera: CameraModel = FRONT, *, rounding: bool = False
) -> LensParts:
    return lens_pos, lens_mat, camera.focal_px, 0.5 if rounding else _WHOLE


def draw_ground(
    scene: Scene, lenses: LensParts, out: Bytes, wanted: Ints, taken: Ints, light: Light | None
) -> None:
    """Threads that share the counter `taken`, an array of one 0, share the work."""
    backdrop = scene.backdrop
    if light is not None:
        greys = light.wall_greys, light.sky_greys, light.palettes
        backdrop = scene.walls_m, scene.wall_height_m, *greys
    raycast.draw(scene.picture, backdrop, lenses, out, wanted, taken)


def draw_solids(
    boxes: Cuboids,
    lenses: LensParts,
    out: Bytes,
    light: Light | None,
    weights: Sequence[float] = LUMA,
) -> None:
    """`weights` of red, green and blue make the greys of `out`."""
    cuboids.draw(boxes, _on_solids(light, len(boxes), weights), lenses, out)


_WHOLE = 1e-3
"""The reference's filter cuts fractions off; a thousandth keeps whole greys whole."""


def _on_solids(light: Light | None, cars: int, weights: Sequence[float]) -> Singles:
    if light is None:
        usual = [weight * part for part in (AMBIENT, SUN) for weight in weights]
        return np.tile(np.array(usual, np.float32), (cars, 1))
    shares = np.array(weights, np.float32)
    return np.concatenate([light.ambient * shares, light.sun * shares], axis=1)

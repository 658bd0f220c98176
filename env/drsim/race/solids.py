"""Boxes and cars as cuboids, for cameras and lidars."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drsim.arrays import RGB, Cuboids, Floats, Ints
from drsim.jit import kernel

CUBOID = np.dtype(
    [
        ("x", np.float32),
        ("y", np.float32),
        ("cos", np.float32),
        ("sin", np.float32),
        ("half_length", np.float32),
        ("half_width", np.float32),
        ("low", np.float32),
        ("high", np.float32),
        ("color", np.float32, 3),
    ]
)
"""Middle, cosine and sine of the yaw, half its size on the floor, lowest and highest z, metres;
red, green, blue, 0 to 255.
"""


@dataclass(frozen=True)
class Box:
    """A cuboid in the frame of its shape: metres forward, left, up from a point on the floor."""

    center_m: tuple[float, float]
    size_m: tuple[float, float]
    low_m: float
    high_m: float
    color: RGB


@dataclass(frozen=True)
class Shape:
    """A kind of object; the footprint decides about crashes."""

    name: str
    boxes: tuple[Box, ...]
    footprint_m: tuple[float, float]


_TYRE: RGB = (25.5, 25.5, 25.5)
_CAR_FOOTPRINT_M = (0.32352, 0.1961)
_BOX_FOOTPRINT_M = (0.5, 0.4)


def _car(name: str, color: RGB) -> Shape:
    """Source of the sizes: the reference simulator's meshes."""
    wheels = tuple(
        Box((x, y), (0.072, 0.034), 0.0, 0.072, _TYRE)
        for x in (-0.0817, 0.0823)
        for y in (-0.0805, 0.0805)
    )
    body = Box((0.004, 0.0), (0.324, 0.12), 0.03, 0.13, color)
    cabin = Box((-0.03, 0.0), (0.16, 0.11), 0.13, 0.218, color)
    return Shape(name, (*wheels, body, cabin), _CAR_FOOTPRINT_M)


def _crate(name: str, length_m: float, width_m: float, high_m: float, color: RGB) -> Shape:
    return Shape(
        name, (Box((0.0, 0.0), (length_m, width_m), 0.0, high_m, color),), _BOX_FOOTPRINT_M
    )


SHAPES: dict[str, Shape] = {
    shape.name: shape
    for shape in (
        _crate("box_obstacle", 0.4, 0.3, 0.25, (123.0, 97.0, 79.0)),
        _crate("deepracer_box_obstacle", 0.36, 0.265, 0.24, (60.0, 60.0, 64.0)),
        _crate("amazon_box_obstacle", 0.4, 0.3, 0.25, (176.0, 137.0, 96.0)),
        _car("bot_car", (39.8, 39.8, 39.8)),
        _car("race_car", (223.9, 25.8, 37.0)),
    )
}
"""Source: the reference simulator's models; the colours of the two printed boxes are assumed."""


class Solids:
    """The solids around each of n cars, k for each and of the same shapes."""

    def __init__(self, num_cars: int, shapes: Sequence[Shape]) -> None:
        parts = [(index, box) for index, shape in enumerate(shapes) for box in shape.boxes]
        self._shape_of = np.array([index for index, _ in parts], np.int64)
        self._center_m = np.array([box.center_m for _, box in parts]).reshape(-1, 2)
        self._keeps_color = np.array([box.color == _TYRE for _, box in parts], np.bool_)
        self.boxes: Cuboids = np.zeros((num_cars, len(parts)), CUBOID)
        for row, (_, box) in enumerate(parts):
            length_m, width_m = box.size_m
            size = (length_m / 2, width_m / 2, box.low_m, box.high_m)
            self.boxes[:, row] = (0.0, 0.0, 1.0, 0.0, *size, box.color)
        everybody = np.arange(num_cars)
        shape = (num_cars, len(shapes))
        self.move(everybody, np.zeros((*shape, 2)), np.zeros(shape))

    def move(self, cars: Ints, xy: Floats, yaw_rad: Floats) -> None:
        """Place the solids of c cars. Shapes (c, k, 2) and (c, k)."""
        _move(self.boxes, cars, xy, yaw_rad, (self._shape_of, self._center_m))

    def paint(self, cars: Ints, colors: Floats) -> None:
        """Paint whole solids, 0 to 255, shape (c, k, 3); no tyres."""
        painted = np.flatnonzero(~self._keeps_color)
        self.boxes["color"][cars[:, None], painted] = colors[:, self._shape_of[painted]]


@kernel
def _move(
    boxes: Cuboids, cars: Ints, xy: Floats, yaw_rad: Floats, parts: tuple[Ints, Floats]
) -> None:
    shape_of, center_m = parts
    for c in range(len(cars)):
        for row in range(len(shape_of)):
            k, box = shape_of[row], boxes[cars[c], row]
            cos, sin = np.cos(yaw_rad[c, k]), np.sin(yaw_rad[c, k])
            x, y = center_m[row, 0], center_m[row, 1]
            box.x = xy[c, k, 0] + cos * x - sin * y
            box.y = xy[c, k, 1] + sin * x + cos * y
            box.cos = cos
            box.sin = sin

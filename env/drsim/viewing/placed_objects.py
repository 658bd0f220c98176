"""What stands on the track in pictures for people."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from drsim.arrays import RGB, Floats, Ints, Vector
from drsim.car.car import WHEEL_RADIUS_M
from drsim.race.solids import Shape
from drsim.viewing.solid_painting import Triangles

PAINT, STRIPED, GLASS, TYRE, RIM, BLACK, LAMP, TAIL, CARD, PRINTED, PLAIN = range(11)
"""Materials; see `solid_painting`."""

WHEELS: tuple[tuple[float, float], ...] = (
    (-0.0817, -0.0805),
    (-0.0817, 0.0805),
    (0.0823, -0.0805),
    (0.0823, 0.0805),
)
"""Forward and left of the car's origin, metres; the front ones last."""

WHEEL_WIDTH_M = 0.034
_SPOKES = 24

_CARS = ("race_car", "bot_car")
_PRINTS = {
    "box_obstacle": CARD,
    "amazon_box_obstacle": CARD,
    "deepracer_box_obstacle": PRINTED,
}

_BODY: tuple[tuple[float, float, float, float, float, float], ...] = (
    (-0.160, 0.036, 0.044, 0.050, 0.084, 0.092),
    (-0.150, 0.048, 0.046, 0.042, 0.088, 0.106),
    (-0.110, 0.056, 0.044, 0.036, 0.088, 0.116),
    (-0.060, 0.062, 0.052, 0.032, 0.086, 0.114),
    (-0.010, 0.064, 0.056, 0.032, 0.082, 0.108),
    (0.040, 0.063, 0.052, 0.032, 0.078, 0.102),
    (0.085, 0.056, 0.040, 0.033, 0.070, 0.088),
    (0.125, 0.050, 0.032, 0.035, 0.060, 0.074),
    (0.150, 0.045, 0.027, 0.037, 0.054, 0.064),
    (0.166, 0.030, 0.020, 0.042, 0.049, 0.054),
)
"""Forward, half widths at shoulder and top, heights of floor, shoulder and top, metres; fills the
reference's size.
"""

_CABIN: tuple[tuple[float, float, float, float, float, float], ...] = (
    (-0.118, 0.030, 0.018, 0.108, 0.112, 0.115),
    (-0.090, 0.044, 0.032, 0.104, 0.124, 0.140),
    (-0.050, 0.050, 0.038, 0.102, 0.132, 0.162),
    (-0.010, 0.051, 0.038, 0.098, 0.130, 0.164),
    (0.025, 0.048, 0.034, 0.096, 0.122, 0.148),
    (0.060, 0.040, 0.024, 0.090, 0.102, 0.112),
    (0.078, 0.028, 0.014, 0.084, 0.090, 0.094),
)


class Mesh(NamedTuple):
    """Triangles in the frame of an object: forward, left, up from the floor, metres.

    Attributes:
        places: Of corners on the surface, metres. Shape (v, 2).
    """

    corners: Floats
    normals: Floats
    places: Floats
    faces: Ints
    materials: Ints


_NOTHING = Mesh(
    np.empty((0, 3)),
    np.empty((0, 3)),
    np.empty((0, 2)),
    np.empty((0, 3), np.int64),
    np.empty(0, np.int64),
)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    meshes = [_NOTHING, *meshes]
    begins = np.cumsum([0, *(len(mesh.corners) for mesh in meshes[:-1])])
    moved = [
        mesh._replace(faces=mesh.faces + begin) for mesh, begin in zip(meshes, begins, strict=True)
    ]
    return Mesh(*(np.concatenate(column) for column in zip(*moved, strict=True)))


def _finished(parts: Sequence[Mesh]) -> Mesh:
    corners, normals, places, faces, materials = joined(parts)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inside_out = (np.cross(b - a, c - a) * normals[faces].sum(axis=1)).sum(axis=1) < 0.0
    outwards = np.where(inside_out[:, None], faces[:, [0, 2, 1]], faces)
    return Mesh(corners, normals, places, outwards, materials)


def meshes_of(shape: Shape) -> list[Mesh]:
    """A car's body and its wheels, or a box."""
    if has_wheels(shape):
        return [car_body(), *[wheel()] * len(WHEELS)]
    parts = []
    for box in shape.boxes:
        middle = (*box.center_m, 0.5 * (box.low_m + box.high_m))
        size = (*box.size_m, box.high_m - box.low_m)
        parts += _box(middle, size, _PRINTS.get(shape.name, PLAIN))
    return [_finished(parts)]


def color_of(shape: Shape, color: RGB | None) -> RGB:
    """0 to 255."""
    if color or not shape.boxes:
        return color or (0.0, 0.0, 0.0)
    return shape.boxes[-1 if has_wheels(shape) else 0].color


def has_wheels(shape: Shape) -> bool:
    return shape.name in _CARS


@cache
def car_body() -> Mesh:
    """About 900 triangles."""
    boxes = [
        ((-0.032, 0.0, 0.1645), (0.062, 0.062, 0.005), PAINT),
        ((-0.150, 0.0, 0.1520), (0.034, 0.150, 0.006), PAINT),
    ]
    for side in (-1.0, 1.0):
        boxes += [
            ((-0.146, 0.032 * side, 0.128), (0.012, 0.004, 0.046), BLACK),
            ((-0.150, 0.0765 * side, 0.152), (0.040, 0.003, 0.024), BLACK),
            ((0.1535, 0.030 * side, 0.0545), (0.012, 0.018, 0.009), LAMP),
            ((-0.1595, 0.031 * side, 0.078), (0.006, 0.022, 0.010), TAIL),
            ((-0.0817, 0.058 * side, 0.040), (0.016, 0.030, 0.006), BLACK),
            ((0.0823, 0.058 * side, 0.040), (0.016, 0.030, 0.006), BLACK),
        ]
    boxes += [
        ((0.0, 0.0, 0.030), (0.300, 0.100, 0.008), BLACK),
        ((-0.150, 0.0, 0.048), (0.022, 0.090, 0.012), BLACK),
        ((0.132, 0.0, 0.092), (0.014, 0.034, 0.022), BLACK),
        ((0.1400, 0.0, 0.094), (0.006, 0.012, 0.012), LAMP),
    ]
    parts = [part for box in boxes for part in _box(*box)]
    return _finished([*_loft(_BODY, STRIPED), *_loft(_CABIN, GLASS), *parts])


@cache
def wheel() -> Mesh:
    """Around the origin; its axle points left."""
    angle = np.arange(_SPOKES) * (2.0 * np.pi / _SPOKES)
    cos, sin = np.cos(angle), np.sin(angle)
    half, radius = WHEEL_WIDTH_M / 2, WHEEL_RADIUS_M
    profile = (
        (-half, 0.66 * radius, -1.0),
        (-half, 0.88 * radius, -0.8),
        (-0.72 * half, radius, -0.3),
        (0.72 * half, radius, 0.3),
        (half, 0.88 * radius, 0.8),
        (half, 0.66 * radius, 1.0),
    )
    rings = np.stack([np.stack([r * cos, np.full(_SPOKES, y), r * sin], -1) for y, r, _ in profile])
    normals = np.stack(
        [
            np.stack([(1 - abs(t)) * cos, np.full(_SPOKES, t), (1 - abs(t)) * sin], -1)
            for _, _, t in profile
        ]
    )
    parts = [_skin(rings, normals, np.zeros((*rings.shape[:2], 2)), TYRE)]
    for sign in (-1.0, 1.0):
        rim = 0.68 * radius
        disc = np.stack([rim * cos, np.full(_SPOKES, sign * 0.94 * half), rim * sin], -1)
        corners = np.concatenate([disc, [[0.0, sign * 0.70 * half, 0.0]]])
        parts.append(_fan(corners, (0.0, sign, 0.0), corners[:, [0, 2]] / radius, RIM))
    return _finished(parts)


def _loft(sections: tuple[tuple[float, ...], ...], material: int) -> list[Mesh]:
    rings = np.stack([_ring(*row) for row in _smooth(np.array(sections), 3)])
    along = np.gradient(rings, axis=0)
    beside = np.roll(rings, -1, axis=1) - np.roll(rings, 1, axis=1)
    normals = np.cross(beside, along)
    middle = rings.mean(axis=1, keepdims=True)
    outwards = np.sign(((rings - middle) * normals).sum(axis=(1, 2), keepdims=True))
    normals *= np.where(outwards == 0, 1.0, outwards)
    parts = [_skin(rings, normals, rings[:, :, :2], material)]
    for ring, sign in ((rings[0], -1.0), (rings[-1], 1.0)):
        corners = np.concatenate([ring, ring.mean(axis=0)[None]])
        parts.append(_fan(corners, (sign, 0.0, 0.15), corners[:, 1:], material))
    return parts


def _part(corners: Floats, normals: Floats, places: Floats, faces: Ints, material: int) -> Mesh:
    return Mesh(corners, normals, places, faces, np.full(len(faces), material, np.int64))


def _fan(corners: Floats, normal: Vector, places: Floats, material: int) -> Mesh:
    """From the last corner to all others."""
    around = len(corners) - 1
    spokes = np.arange(around)
    faces = np.stack([spokes, (spokes + 1) % around, np.full(around, around)], -1)
    return _part(corners, np.tile(normal, (len(corners), 1)), places, faces, material)


def _skin(rings: Floats, normals: Floats, places: Floats, material: int) -> Mesh:
    count, around, _ = rings.shape
    index = np.arange(count * around).reshape(count, around)
    a, b = index[:-1], index[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    faces = np.concatenate([np.stack(each, -1).reshape(-1, 3) for each in ((a, b, c), (c, b, d))])
    corners = rings.reshape(-1, 3)
    return _part(corners, normals.reshape(-1, 3), places.reshape(-1, 2), faces, material)


def _smooth(table: Floats, times: int) -> Floats:
    at = np.arange(len(table), dtype=float)
    wanted = np.linspace(0.0, len(table) - 1.0, (len(table) - 1) * times + 1)
    slope = np.gradient(table, axis=0)
    first = np.minimum(wanted.astype(int), len(table) - 2)
    t = (wanted - at[first])[:, None]
    a, b, m, n = table[first], table[first + 1], slope[first], slope[first + 1]
    return np.asarray(
        (2 * t**3 - 3 * t**2 + 1) * a
        + (t**3 - 2 * t**2 + t) * m
        + (3 * t**2 - 2 * t**3) * b
        + (t**3 - t**2) * n
    )


def _ring(
    forward: float, wide: float, narrow: float, floor: float, shoulder: float, top: float
) -> Floats:
    half = [
        (0.0, floor),
        (0.72 * wide, floor),
        (0.94 * wide, floor + 0.12 * (shoulder - floor)),
        (wide, floor + 0.55 * (shoulder - floor)),
        (0.99 * wide, shoulder),
        (0.90 * wide, shoulder + 0.35 * (top - shoulder)),
        (0.5 * (wide + narrow), shoulder + 0.68 * (top - shoulder)),
        (narrow, shoulder + 0.90 * (top - shoulder)),
        (0.6 * narrow, top),
        (0.0, top),
    ]
    left = [(forward, y, z) for y, z in half]
    return np.array(left + [(forward, -y, z) for y, z in half[-2:0:-1]])


def _box(middle: Vector, size: Vector, material: int) -> list[Mesh]:
    half = np.array(size) / 2.0
    # Places run over each face from -1 to 1: what is printed on a box fits every size.
    flat = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    parts = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            corners = np.tile(np.array(middle), (4, 1))
            corners[:, axis] += sign * half[axis]
            corners[:, [first, second]] += flat * half[[first, second]]
            normals = np.zeros((4, 3))
            normals[:, axis] = sign
            parts.append(_part(corners, normals, flat, _SQUARE, material))
    return parts


_SQUARE = np.array([[0, 1, 2], [0, 2, 3]])

OPPONENT_COLOR: RGB = (255.0, 159.9, 9.9)
"""As in the reference."""


@dataclass(frozen=True)
class PlacedObject:
    """A car or a box in a picture.

    Attributes:
        pose: Metres and radians.
        color: 0 to 255.
        steering_rad: To the left.
        roll_rad: To the right.
        dip_rad: Nose down.
        ghost: Whether one sees through it.
    """

    shape: Shape
    pose: tuple[float, float, float]
    color: RGB | None = None
    steering_rad: float = 0.0
    rolled_m: float = 0.0
    roll_rad: float = 0.0
    dip_rad: float = 0.0
    ghost: bool = False


Kinds = tuple[tuple[Shape, RGB | None, bool], ...]
"""Shape, colour, and whether it is a ghost, of all things; ghosts last."""


class ThingMeshes:
    """The meshes of all things together; each car has five parts, its body and its wheels.

    `owner` is each corner's part; `solid_faces` excludes ghosts.
    """

    def __init__(self, kinds: Kinds) -> None:
        self.kinds = kinds
        parts = [
            (thing, mesh) for thing, (shape, *_) in enumerate(kinds) for mesh in meshes_of(shape)
        ]
        things = np.array([thing for thing, _ in parts], np.int64)
        faces = np.array([len(mesh.faces) for _, mesh in parts], np.int64)
        corners = [len(mesh.corners) for _, mesh in parts]
        self.solid_faces = int(sum(faces[[not kinds[thing][2] for thing in things]]))
        self.owner: Ints = np.repeat(np.arange(len(parts)), corners)
        colors = [color_of(shape, color) for shape, color, _ in kinds]
        self.triangles = Triangles(
            *joined([mesh for _, mesh in parts]),
            np.repeat(things, faces),
            np.array(colors, np.float64).reshape(-1, 3) / 255.0,
        )


def placed(things: Sequence[PlacedObject]) -> tuple[Floats, Floats]:
    turns: list[Floats] = []
    shifts: list[Floats] = []
    for thing in things:
        x, y, yaw = thing.pose
        level = _about(2, yaw)
        place = np.array([x, y, 0.0])
        wheels = has_wheels(thing.shape)
        body = level @ _about(0, thing.roll_rad) @ _about(1, thing.dip_rad) if wheels else level
        turns.append(body)
        shifts.append(place)
        if wheels:
            roll = _about(1, thing.rolled_m / WHEEL_RADIUS_M)
            steer = _about(2, thing.steering_rad)
            for number, (forward, left) in enumerate(WHEELS):
                turns.append(level @ steer @ roll if number >= 2 else level @ roll)
                shifts.append(place + level @ np.array([forward, left, WHEEL_RADIUS_M]))
    return np.array(turns).reshape(-1, 3, 3), np.array(shifts).reshape(-1, 3)


def _about(axis: int, angle_rad: float) -> Floats:
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[first, first] = turn[second, second] = cos
    turn[first, second], turn[second, first] = -sin, sin
    return turn

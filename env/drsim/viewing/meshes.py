"""Triangles of cars with a shell, and of boxes, for pictures."""

from dataclasses import dataclass

import numpy as np

from drsim.arrays import Floats, Ints
from drsim.car.car import WHEEL_RADIUS_M
from drsim.race.solids import Shape

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


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in the frame of an object: forward, left, up from the floor, metres.

    Attributes:
        places: Of corners on the surface, metres. Shape (v, 2).
        color: 0 to 255.
    """

    corners: Floats
    normals: Floats
    places: Floats
    faces: Ints
    materials: Ints
    color: tuple[float, float, float]


class _Builder:
    def __init__(self) -> None:
        self.corners: list[Floats] = []
        self.normals: list[Floats] = []
        self.places: list[Floats] = []
        self.faces: list[Ints] = []
        self.materials: list[Ints] = []
        self._count = 0

    def add(
        self, corners: Floats, normals: Floats, places: Floats, faces: Ints, material: int
    ) -> None:
        self.corners.append(corners)
        self.normals.append(normals)
        self.places.append(places)
        self.faces.append(faces + self._count)
        self.materials.append(np.full(len(faces), material, np.int64))
        self._count += len(corners)

    def mesh(self, color: tuple[float, float, float]) -> Mesh:
        if not self.corners:
            nothing = np.empty((0, 3))
            return Mesh(
                nothing,
                nothing,
                np.empty((0, 2)),
                np.empty((0, 3), np.int64),
                np.empty(0, np.int64),
                color,
            )
        corners, faces = np.concatenate(self.corners), np.concatenate(self.faces)
        normals = np.concatenate(self.normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return Mesh(
            corners,
            normals,
            np.concatenate(self.places),
            _outwards(corners, normals, faces),
            np.concatenate(self.materials),
            color,
        )


def _outwards(corners: Floats, normals: Floats, faces: Ints) -> Ints:
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inside_out = (np.cross(b - a, c - a) * normals[faces].sum(axis=1)).sum(axis=1) < 0.0
    return np.where(inside_out[:, None], faces[:, [0, 2, 1]], faces)


def mesh_of(shape: Shape, color: tuple[float, float, float] | None = None) -> Mesh:
    if has_wheels(shape):
        return car_body(color or shape.boxes[-1].color)
    builder = _Builder()
    for box in shape.boxes:
        middle = (*box.center_m, 0.5 * (box.low_m + box.high_m))
        size = (*box.size_m, box.high_m - box.low_m)
        _add_box(builder, middle, size, _PRINTS.get(shape.name, PLAIN))
    return builder.mesh(color or (shape.boxes[0].color if shape.boxes else (0.0, 0.0, 0.0)))


def has_wheels(shape: Shape) -> bool:
    return shape.name in _CARS


def car_body(color: tuple[float, float, float]) -> Mesh:
    """About 900 triangles."""
    builder = _Builder()
    _add_loft(builder, _BODY, STRIPED)
    _add_loft(builder, _CABIN, GLASS)
    _add_box(builder, (-0.032, 0.0, 0.1645), (0.062, 0.062, 0.005), PAINT)
    _add_box(builder, (-0.150, 0.0, 0.1520), (0.034, 0.150, 0.006), PAINT)
    for side in (-1.0, 1.0):
        _add_box(builder, (-0.146, 0.032 * side, 0.128), (0.012, 0.004, 0.046), BLACK)
        _add_box(builder, (-0.150, 0.0765 * side, 0.152), (0.040, 0.003, 0.024), BLACK)
        _add_box(builder, (0.1535, 0.030 * side, 0.0545), (0.012, 0.018, 0.009), LAMP)
        _add_box(builder, (-0.1595, 0.031 * side, 0.078), (0.006, 0.022, 0.010), TAIL)
        for forward in (-0.0817, 0.0823):
            _add_box(builder, (forward, 0.058 * side, 0.040), (0.016, 0.030, 0.006), BLACK)
    _add_box(builder, (0.0, 0.0, 0.030), (0.300, 0.100, 0.008), BLACK)
    _add_box(builder, (-0.150, 0.0, 0.048), (0.022, 0.090, 0.012), BLACK)
    _add_box(builder, (0.132, 0.0, 0.092), (0.014, 0.034, 0.022), BLACK)
    _add_box(builder, (0.1400, 0.0, 0.094), (0.006, 0.012, 0.012), LAMP)
    return builder.mesh(color)


def wheel() -> Mesh:
    """Around the origin; its axle points left."""
    builder = _Builder()
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
    corners, faces = _skin(rings)
    builder.add(corners, normals.reshape(-1, 3), np.zeros((len(corners), 2)), faces, TYRE)
    spokes = np.arange(_SPOKES)
    fan = np.stack([spokes, (spokes + 1) % _SPOKES, np.full(_SPOKES, _SPOKES)], -1)
    for sign in (-1.0, 1.0):
        rim = 0.68 * radius
        disc = np.stack([rim * cos, np.full(_SPOKES, sign * 0.94 * half), rim * sin], -1)
        corners = np.concatenate([disc, [[0.0, sign * 0.70 * half, 0.0]]])
        places = corners[:, [0, 2]] / radius
        builder.add(corners, np.tile([0.0, sign, 0.0], (len(corners), 1)), places, fan, RIM)
    return builder.mesh((0.0, 0.0, 0.0))


def _add_loft(builder: _Builder, sections: tuple[tuple[float, ...], ...], material: int) -> None:
    table = _smooth(np.array(sections), 3)
    rings = np.stack([_ring(*row) for row in table])
    around = rings.shape[1]
    along = np.gradient(rings, axis=0)
    beside = np.roll(rings, -1, axis=1) - np.roll(rings, 1, axis=1)
    normals = np.cross(beside, along)
    middle = rings.mean(axis=1, keepdims=True)
    outwards = np.sign(((rings - middle) * normals).sum(axis=(1, 2), keepdims=True))
    normals *= np.where(outwards == 0, 1.0, outwards)
    places = rings[:, :, :2]
    corners, faces = _skin(rings)
    builder.add(corners, normals.reshape(-1, 3), places.reshape(-1, 2), faces, material)
    for ring, sign in ((rings[0], -1.0), (rings[-1], 1.0)):
        corners = np.concatenate([ring, ring.mean(axis=0)[None]])
        normal = np.tile([sign, 0.0, 0.15], (len(corners), 1))
        spokes = np.arange(around)
        cap = np.stack([spokes, (spokes + 1) % around, np.full(around, around)], -1)
        builder.add(corners, normal, corners[:, 1:], cap, material)


def _skin(rings: Floats) -> tuple[Floats, Ints]:
    count, around, _ = rings.shape
    index = np.arange(count * around).reshape(count, around)
    a, b = index[:-1], index[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    first, second = np.stack([a, b, c], -1), np.stack([c, b, d], -1)
    return rings.reshape(-1, 3), np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


def _smooth(table: Floats, times: int) -> Floats:
    at = np.arange(len(table), dtype=float)
    wanted = np.linspace(0.0, len(table) - 1.0, (len(table) - 1) * times + 1)
    slope = np.gradient(table, axis=0)
    first = np.minimum(wanted.astype(int), len(table) - 2)
    t = (wanted - at[first])[:, None]
    a, b, m, n = table[first], table[first + 1], slope[first], slope[first + 1]
    between: Floats = (
        (2 * t**3 - 3 * t**2 + 1) * a
        + (t**3 - 2 * t**2 + t) * m
        + (3 * t**2 - 2 * t**3) * b
        + (t**3 - t**2) * n
    )
    return between


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
    right = [(forward, -y, z) for y, z in half[-2:0:-1]]
    return np.array(left + right)


def _add_box(
    builder: _Builder,
    middle: tuple[float, float, float],
    size: tuple[float, float, float],
    material: int,
) -> None:
    half = np.array(size) / 2.0
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            corners = np.tile(np.array(middle), (4, 1))
            corners[:, axis] += sign * half[axis]
            corners[:, first] += np.array([-1, 1, 1, -1]) * half[first]
            corners[:, second] += np.array([-1, -1, 1, 1]) * half[second]
            normal = np.zeros((4, 3))
            normal[:, axis] = sign
            # Places run over each face from -1 to 1: what is printed on a box fits every size.
            flat = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            builder.add(corners, normal, flat, faces, material)

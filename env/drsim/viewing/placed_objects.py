"""What stands on the track in pictures for people."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drsim.arrays import Floats, Ints
from drsim.car.car import WHEEL_RADIUS_M
from drsim.race.solids import Shape
from drsim.track.appearance import RGB
from drsim.viewing.meshes import WHEELS, Mesh, has_wheels, mesh_of, wheel
from drsim.viewing.pixel_rows import LensParts
from drsim.viewing.solid_painting import Triangles, project

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


@dataclass(frozen=True, eq=False)
class ThingMeshes:
    """The meshes of all things together; each car has five parts, its body and its wheels.

    `owner` is each corner's part; `solid_faces` excludes ghosts.
    """

    kinds: tuple[tuple[Shape, RGB | None, bool], ...]
    triangles: Triangles
    owner: Ints
    solid_faces: int

    @staticmethod
    def of(kinds: tuple[tuple[Shape, RGB | None, bool], ...]) -> "ThingMeshes":
        parts = _Parts()
        tyre = wheel()
        solid_faces = 0
        for number, (shape, color, ghost) in enumerate(kinds):
            parts.add(mesh_of(shape, color), number)
            if has_wheels(shape):
                for _ in WHEELS:
                    parts.add(tyre, number)
            if not ghost:
                solid_faces = parts.faces_so_far
        colors = [mesh_of(shape, color).color for shape, color, _ in kinds]
        triangles, owner = parts.joined(np.array(colors, np.float64).reshape(-1, 3) / 255.0)
        return ThingMeshes(kinds, triangles, owner, solid_faces)

    def seen(
        self, turns: Floats, shifts: Floats, lens: LensParts, size: tuple[int, int]
    ) -> tuple[object, ...]:
        made = self.triangles
        corners, normals = np.empty_like(made.corners), np.empty_like(made.normals)
        project(made.corners, made.normals, turns, shifts, self.owner, lens, size, corners, normals)
        return (corners, normals, *made[2:])


@dataclass
class _Parts:
    meshes: list[Mesh] = field(default_factory=list)
    things: list[int] = field(default_factory=list)
    faces_so_far: int = 0

    def add(self, mesh: Mesh, thing: int) -> None:
        self.meshes.append(mesh)
        self.things.append(thing)
        self.faces_so_far += len(mesh.faces)

    def joined(self, colors: Floats) -> tuple[Triangles, Ints]:
        if not self.meshes:
            none = np.empty((0, 3))
            no = np.empty(0, np.int64)
            empty = Triangles(none, none, none[:, :2], np.empty((0, 3), np.int64), no, no, colors)
            return empty, no
        counts = [len(mesh.corners) for mesh in self.meshes]
        begins = np.cumsum([0, *counts[:-1]])
        faces = [mesh.faces + begin for mesh, begin in zip(self.meshes, begins, strict=True)]
        per_part = [len(mesh.faces) for mesh in self.meshes]
        triangles = Triangles(
            np.concatenate([mesh.corners for mesh in self.meshes]),
            np.concatenate([mesh.normals for mesh in self.meshes]),
            np.concatenate([mesh.places for mesh in self.meshes]),
            np.concatenate(faces),
            np.concatenate([mesh.materials for mesh in self.meshes]),
            np.repeat(np.array(self.things, np.int64), per_part),
            colors,
        )
        return triangles, np.repeat(np.arange(len(self.meshes)), counts)


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

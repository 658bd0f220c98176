"""The sensors of a car: names in model_metadata.json, spaces and filters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from drsim.arrays import Cuboids, Floats, Singles
from drsim.car.car import FRONT
from drsim.errors import require
from drsim.jit import kernel


@dataclass(frozen=True)
class LidarModel:
    """A lidar. Source of the defaults: the reference simulator's launch files.

    Attributes:
        sweep_rad: From the first ray to the last.
        mount_m: In the car's base frame: forward, up.
        yaw_rad: Of the middle of the sweep. The reference's is blind 30 degrees to either side of
            straight ahead; models were trained on that.
    """

    samples: int = 64
    sweep_rad: float = 2 * 2.61799
    range_m: tuple[float, float] = (0.15, 12.0)
    mount_m: tuple[float, float] = (0.02913, 0.184699)
    yaw_rad: float = math.pi

    @property
    def bearings_rad(self) -> Floats:
        """Counter-clockwise. Shape (samples,)."""
        half_rad = self.sweep_rad / 2
        return self.yaw_rad + np.linspace(-half_rad, half_rad, self.samples)


LIDAR = LidarModel()


class _Ray(NamedTuple):
    x: float
    y: float
    dx: float
    dy: float


def scan(
    walls_m: Singles,
    wall_height_m: float,
    boxes: Cuboids,
    body_xy: Floats,
    yaw_rad: Floats,
    lidar: LidarModel = LIDAR,
) -> Singles:
    """Distances in metres; infinite where nothing is in range. Shape (n, samples).

    Walls lower than the scanner are not seen.
    """
    forward_m, height_m = lidar.mount_m
    least_m, most_m = lidar.range_m
    scanner = lidar.bearings_rad, forward_m, height_m, least_m, most_m
    return _scan(walls_m, wall_height_m > height_m, boxes, body_xy, yaw_rad, scanner)


@kernel
def _scan(
    walls_m: Singles,
    sees_walls: bool,
    boxes: Cuboids,
    body_xy: Floats,
    yaw_rad: Floats,
    scanner: tuple[Floats, float, float, float, float],
) -> Singles:
    bearings_rad, forward_m, height_m, least_m, most_m = scanner
    out = np.empty((len(body_xy), len(bearings_rad)), np.float32)
    for car in range(len(body_xy)):
        x = body_xy[car, 0] + forward_m * math.cos(yaw_rad[car])
        y = body_xy[car, 1] + forward_m * math.sin(yaw_rad[car])
        for i in range(len(bearings_rad)):
            angle_rad = yaw_rad[car] + bearings_rad[i]
            ray = _Ray(x, y, math.cos(angle_rad), math.sin(angle_rad))
            nearest_m = math.inf
            if sees_walls:
                nearest_m = _to_walls(walls_m, ray)
            for k in range(boxes.shape[1]):
                box = boxes[car, k]
                if box.low <= height_m <= box.high:
                    nearest_m = min(nearest_m, _to_box(box, ray, least_m))
            in_range = least_m <= nearest_m <= most_m
            out[car, i] = nearest_m if in_range else math.inf
    return out


@kernel
def _to_walls(walls_m: Singles, ray: _Ray) -> float:
    if not (walls_m[0] < ray.x < walls_m[1] and walls_m[2] < ray.y < walls_m[3]):
        return math.inf
    to_x, to_y = math.inf, math.inf
    if ray.dx != 0.0:
        to_x = ((walls_m[1] if ray.dx > 0 else walls_m[0]) - ray.x) / ray.dx
    if ray.dy != 0.0:
        to_y = ((walls_m[3] if ray.dy > 0 else walls_m[2]) - ray.y) / ray.dy
    return min(to_x, to_y)


@kernel
def _to_box(box: Any, ray: _Ray, least_m: float) -> float:
    """To the first side that is not nearer than the least; else infinite. The slab method."""
    cos, sin = box.cos, box.sin
    away_x, away_y = ray.x - box.x, ray.y - box.y
    along, across = cos * away_x + sin * away_y, cos * away_y - sin * away_x
    along_d, across_d = cos * ray.dx + sin * ray.dy, cos * ray.dy - sin * ray.dx
    enter, leave = -math.inf, math.inf
    for axis in range(2):
        place, step, half = (
            (along, along_d, box.half_length) if axis == 0 else (across, across_d, box.half_width)
        )
        if step == 0.0:
            if abs(place) > half:
                return math.inf
            continue
        first, second = (-half - place) / step, (half - place) / step
        enter = max(enter, min(first, second))
        leave = min(leave, max(first, second))
    if enter > leave:
        return math.inf
    if enter >= least_m:
        return enter
    return leave if leave >= least_m else math.inf


EYES = {"FRONT_FACING_CAMERA": 1, "LEFT_CAMERA": 1, "observation": 1, "STEREO_CAMERAS": 2}
CAMERAS = tuple(EYES)
LIDARS = ("LIDAR", "SECTOR_LIDAR", "DISCRETIZED_SECTOR_LIDAR")

_LEAST_M, _MOST_M = 0.15, 1.0
"""Limits of LIDAR. Source: the reference simulator's filter."""

_SECTORS = 8
_SECTOR_NEAR_M = 0.5
"""Below it a sector is 1. Source: the reference."""


@dataclass(frozen=True)
class Sensors:
    """The sensors of a car: one camera, and perhaps a lidar.

    Attributes:
        names: Of model_metadata.json, in any order.
        num_sectors: Of DISCRETIZED_SECTOR_LIDAR; must divide the 64 rays.
        values_per_sector: Distance bins in each.
        clipping_m: Where the bins end.
        lidar_forward: Off, because the reference's lidar looks backwards and models were trained
            on that.
    """

    names: tuple[str, ...] = ("FRONT_FACING_CAMERA",)
    num_sectors: int = 8
    values_per_sector: int = 8
    clipping_m: float = 2.0
    lidar_forward: bool = False

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown name, not exactly one camera, or wrong sectors."""
        unknown = [name for name in self.names if name not in CAMERAS + LIDARS]
        if unknown:
            raise ValueError(
                f"{unknown[0]} is not a sensor; choose from {', '.join(CAMERAS + LIDARS)}."
            )
        if sum(name in CAMERAS for name in self.names) != 1:
            raise ValueError(
                f"A car needs exactly one of {', '.join(CAMERAS)}, not {list(self.names)}."
            )
        if sum(name in LIDARS for name in self.names) > 1:
            raise ValueError(
                f"A car carries at most one of {', '.join(LIDARS)}, not {list(self.names)}."
            )
        good = self.num_sectors >= 1 and LIDAR.samples % self.num_sectors == 0
        require(good, "num_sectors", self.num_sectors, f"divide the {LIDAR.samples} rays")
        if self.values_per_sector < 1 or not 0.0 < self.clipping_m < math.inf:
            raise ValueError(
                "values_per_sector must be at least 1 and clipping_m more than 0, not "
                f"{self.values_per_sector} and {self.clipping_m}."
            )

    @property
    def camera(self) -> str:
        return next(name for name in self.names if name in CAMERAS)

    @property
    def eyes(self) -> int:
        return EYES[self.camera]

    @property
    def lidar(self) -> str | None:
        return next((name for name in self.names if name in LIDARS), None)

    @property
    def lidar_model(self) -> LidarModel:
        return replace(LIDAR, yaw_rad=0.0) if self.lidar_forward else LIDAR

    @property
    def num_values(self) -> int:
        return int(self.process(np.zeros((1, LIDAR.samples), np.float32)).size)

    @property
    def sectors(self) -> int:
        """Parts of the sweep that one tells apart: groups of four rays without sectors."""
        return {"LIDAR": LIDAR.samples // 4, "SECTOR_LIDAR": _SECTORS}.get(
            self.lidar or "", self.num_sectors
        )

    def space(self, *, color: bool = False) -> gym.Space[object]:
        """What one car perceives: a Box of its camera, or a Dict with camera and lidar by name.

        In `color` always a Dict.
        """
        shape = FRONT.rows, FRONT.columns, self.eyes
        frame = gym.spaces.Box(0, 255, (3, *shape[:2]) if color else shape, np.uint8)
        if self.lidar is None:
            return gym.spaces.Dict({self.camera: frame}) if color else frame
        low, high = (_LEAST_M, _MOST_M) if self.lidar == "LIDAR" else (0.0, 1.0)
        values = gym.spaces.Box(low, high, (self.num_values,), np.float32)
        return gym.spaces.Dict({self.camera: frame, self.lidar: values})

    def process(self, rays_m: Singles) -> Singles:
        """From scans, shape (n, 64), to what the model gets, as in the reference.

        LIDAR: clipped to 0.15 .. 1 m. SECTOR_LIDAR: 1 where the nearest of 8 rays is nearer than
        0.5 m. DISCRETIZED_SECTOR_LIDAR: the bin of each sector's nearest distance, one-hot, or 0.
        """
        if self.lidar is None:
            return np.empty((len(rays_m), 0), np.float32)
        if self.lidar == "LIDAR":
            return np.clip(rays_m, np.float32(_LEAST_M), np.float32(_MOST_M))
        nearest_m = rays_m.reshape(len(rays_m), self.sectors, -1).min(axis=2)
        if self.lidar == "SECTOR_LIDAR":
            return np.asarray(nearest_m < _SECTOR_NEAR_M, np.float32)
        bin_m = self.clipping_m / self.values_per_sector
        bins = np.floor(np.minimum(nearest_m, self.clipping_m) / bin_m).astype(np.int64)
        one_hot = bins[..., None] == np.arange(self.values_per_sector)
        return np.asarray(one_hot.reshape(len(rays_m), -1), np.float32)


def sensors_of(names: Sensors | str | Sequence[str]) -> Sensors:
    if isinstance(names, Sensors):
        return names
    return Sensors((names,) if isinstance(names, str) else tuple(names))

"""The sensors of a car: names in model_metadata.json, spaces and filters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import gymnasium as gym
import numpy as np

from drsim.arrays import Singles
from drsim.car.camera_mount import FRONT
from drsim.sensing.lidar import LIDAR, LidarModel

CAMERAS = ("FRONT_FACING_CAMERA", "LEFT_CAMERA", "observation", "STEREO_CAMERAS")
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
        if self.num_sectors < 1 or LIDAR.samples % self.num_sectors:
            raise ValueError(
                f"num_sectors is {self.num_sectors}; it must divide the {LIDAR.samples} rays."
            )
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
        return 2 if self.camera == "STEREO_CAMERAS" else 1

    @property
    def lidar(self) -> str | None:
        return next((name for name in self.names if name in LIDARS), None)

    @property
    def lidar_model(self) -> LidarModel:
        return replace(LIDAR, yaw_rad=0.0) if self.lidar_forward else LIDAR

    @property
    def num_values(self) -> int:
        if self.lidar is None:
            return 0
        return {"LIDAR": LIDAR.samples, "SECTOR_LIDAR": _SECTORS}.get(
            self.lidar, self.num_sectors * self.values_per_sector
        )

    def space(self) -> gym.Space[object]:
        """What one car perceives: a Box of its camera, or a Dict with camera and lidar by name."""
        frame = gym.spaces.Box(0, 255, (FRONT.rows, FRONT.columns, self.eyes), np.uint8)
        if self.lidar is None:
            return frame
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
        if self.lidar == "SECTOR_LIDAR":
            nearest_m = rays_m.reshape(len(rays_m), _SECTORS, -1).min(axis=2)
            near: Singles = (nearest_m < _SECTOR_NEAR_M).astype(np.float32)
            return near
        nearest_m = rays_m.reshape(len(rays_m), self.num_sectors, -1).min(axis=2)
        bin_m = self.clipping_m / self.values_per_sector
        bins = np.floor(np.minimum(nearest_m, self.clipping_m) / bin_m).astype(np.int64)
        one_hot = bins[..., None] == np.arange(self.values_per_sector)
        values: Singles = one_hot.reshape(len(rays_m), -1).astype(np.float32)
        return values


def sensors_of(names: Sensors | str | Sequence[str]) -> Sensors:
    if isinstance(names, Sensors):
        return names
    return Sensors((names,) if isinstance(names, str) else tuple(names))

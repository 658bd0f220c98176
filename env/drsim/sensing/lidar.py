"""The lidar: distances around a car to walls and cuboids."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import Cuboids, Floats, Singles
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

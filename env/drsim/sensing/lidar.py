"""The lidar: distances around a car to walls and to what stands on the floor."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drsim.jit import kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@dataclass(frozen=True)
class LidarModel:
    """Numbers of a lidar. Source of the defaults: the reference simulator's launch files.

    Attributes:
        samples: Rays in one scan.
        sweep_rad: Angle between the first ray and the last.
        range_m: Least and greatest distance that is measured.
        mount_m: Scanner in the car's base frame: forward, up.
        yaw_rad: Which way the middle of the sweep looks. The reference mounts it backwards, so that
            it is blind 30 degrees to either side of straight ahead; its models know it so.
    """

    samples: int = 64
    sweep_rad: float = 2 * 2.61799
    range_m: tuple[float, float] = (0.15, 12.0)
    mount_m: tuple[float, float] = (0.02913, 0.184699)
    yaw_rad: float = math.pi

    @property
    def bearings_rad(self) -> Floats:
        """Directions of the rays relative to the car, counter-clockwise. Shape (samples,)."""
        half_rad = self.sweep_rad / 2
        return self.yaw_rad + np.linspace(-half_rad, half_rad, self.samples)


LIDAR = LidarModel()


def scan(
    walls_m: Singles,
    wall_height_m: float,
    boxes: Singles,
    body_xy: Floats,
    yaw_rad: Floats,
    out: Singles,
    lidar: LidarModel = LIDAR,
) -> None:
    """Measure all rays of all cars, with every step and without noise.

    Args:
        walls_m: Inner faces of the walls: least x, greatest x, least y, greatest y. Shape (4,).
        wall_height_m: Their height; walls lower than the scanner are not seen.
        boxes: Cuboids around each car, rows as in `solids.BOX_COLUMNS`. Shape (n, m, columns).
        body_xy: Car origins in the world, metres. Shape (n, 2).
        yaw_rad: Their headings. Shape (n,).
        out: Written: distances in metres; infinite where nothing is in range. Shape (n, samples).
        lidar: The lidar's numbers.
    """
    forward_m, height_m = lidar.mount_m
    _scan(
        walls_m,
        wall_height_m > height_m,
        boxes,
        body_xy,
        yaw_rad,
        lidar.bearings_rad,
        forward_m,
        height_m,
        lidar.range_m[0],
        lidar.range_m[1],
        out,
    )


@kernel
def _scan(
    walls_m: Singles,
    sees_walls: bool,
    boxes: Singles,
    body_xy: Floats,
    yaw_rad: Floats,
    bearings_rad: Floats,
    forward_m: float,
    height_m: float,
    least_m: float,
    most_m: float,
    out: Singles,
) -> None:
    for car in range(len(body_xy)):
        x = body_xy[car, 0] + forward_m * math.cos(yaw_rad[car])
        y = body_xy[car, 1] + forward_m * math.sin(yaw_rad[car])
        for ray in range(len(bearings_rad)):
            dx = math.cos(yaw_rad[car] + bearings_rad[ray])
            dy = math.sin(yaw_rad[car] + bearings_rad[ray])
            nearest_m = math.inf
            if sees_walls:
                nearest_m = _to_walls(walls_m, x, y, dx, dy)
            for k in range(boxes.shape[1]):
                box = boxes[car, k]
                if box[6] <= height_m <= box[7]:
                    nearest_m = min(nearest_m, _to_box(box, x, y, dx, dy, least_m))
            in_range = least_m <= nearest_m <= most_m
            out[car, ray] = nearest_m if in_range else math.inf


@kernel
def _to_walls(walls_m: Singles, x: float, y: float, dx: float, dy: float) -> float:
    """Distance to the walls from inside them; infinite from outside or for what is no number."""
    if not (walls_m[0] < x < walls_m[1] and walls_m[2] < y < walls_m[3]):
        return math.inf
    to_x, to_y = math.inf, math.inf
    if dx != 0.0:
        to_x = ((walls_m[1] if dx > 0 else walls_m[0]) - x) / dx
    if dy != 0.0:
        to_y = ((walls_m[3] if dy > 0 else walls_m[2]) - y) / dy
    return min(to_x, to_y)


@kernel
def _to_box(box: Singles, x: float, y: float, dx: float, dy: float, least_m: float) -> float:
    """Distance to the first side of a cuboid that is not nearer than the least; else infinite."""
    cos, sin = box[2], box[3]
    away_x, away_y = x - box[0], y - box[1]
    along, across = cos * away_x + sin * away_y, cos * away_y - sin * away_x
    along_d, across_d = cos * dx + sin * dy, cos * dy - sin * dx
    enter, leave = -math.inf, math.inf
    for axis in range(2):
        place, step, half = (along, along_d, box[4]) if axis == 0 else (across, across_d, box[5])
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

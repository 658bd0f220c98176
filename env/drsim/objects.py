"""What a reward function is told about the objects around each car."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drsim.camera import FRONT
from drsim.car import REFERENCE_POINT_AHEAD_M

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_NEAR_M = 0.2
"""Least depth at which an object counts as seen. Source: the reference simulator."""


@dataclass(frozen=True)
class Objects:
    """The k objects of each of n cars, in the order of the reference: racers, obstacles, bots.

    Attributes:
        xy: Places on the floor, metres. Shape (n, k, 2).
        yaw_rad: Directions. Shape (n, k).
        footprint_m: Length and width of the crash rectangles. Shape (k, 2).
        distance_m: Along the centre line from waypoint 0 in the car's driving direction, metres.
            Shape (n, k).
        from_center_m: Distances from the centre line. Shape (n, k).
        left_of_center: Whether they stand left of it. Shape (n, k).
        speed_mps: What their speed is said to be. Shape (k,).
        tells_heading: Whether their heading is told; that of a box is always 0. Shape (k,).
    """

    xy: Floats
    yaw_rad: Floats
    footprint_m: Floats
    distance_m: Floats
    from_center_m: Floats
    left_of_center: Bools
    speed_mps: Floats
    tells_heading: Bools

    def closest(self, cars: Ints, along_m: Floats) -> tuple[Ints, Ints]:
        """Indices of the objects before and after some cars, along the lap and round its end.

        Args:
            cars: Which cars. Shape (c,).
            along_m: Where they are along the centre line. Shape (c,).

        Returns:
            Previous and next object. Each of shape (c,).
        """
        here = along_m[:, None]
        distance_m = self.distance_m[cars]
        ahead = distance_m > here
        order = np.argsort(distance_m, axis=1, kind="stable")
        rank = (~ahead).sum(axis=1)  # objects at or behind the car
        rows = np.arange(len(cars))
        count = distance_m.shape[1]
        return order[rows, (rank - 1) % count], order[rows, rank % count]

    def in_camera(self, cars: Ints, which: Ints, front_xy: Floats, heading_rad: Floats) -> Bools:
        """Whether a car's camera sees the centre or a floor corner of one of its objects.

        The camera is taken at its nominal place, as the reference does.

        Args:
            cars: Which cars. Shape (c,).
            which: An object of each. Shape (c,).
            front_xy: The cars' points 0.14 m ahead of their origins. Shape (c, 2).
            heading_rad: Their yaws. Shape (c,).
        """
        forward = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=1)
        lens = front_xy + (FRONT.mount_m[0] - REFERENCE_POINT_AHEAD_M) * forward
        yaw = self.yaw_rad[cars, which]
        half = 0.5 * self.footprint_m[which]
        along = half[:, :1] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        across = half[:, 1:] * np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
        center = self.xy[cars, which]
        points = np.stack(
            [
                center,
                center + along + across,
                center + along - across,
                center - along + across,
                center - along - across,
            ],
            axis=1,
        )
        apart = points - lens[:, None]
        ahead_m = apart[..., 0] * forward[:, None, 0] + apart[..., 1] * forward[:, None, 1]
        left_m = apart[..., 1] * forward[:, None, 0] - apart[..., 0] * forward[:, None, 1]
        down_m = FRONT.mount_m[2]
        cos, sin = math.cos(FRONT.pitch_rad), math.sin(FRONT.pitch_rad)
        depth_m = cos * ahead_m + sin * down_m
        up_m = sin * ahead_m - cos * down_m
        wide = math.tan(FRONT.field_of_view_rad / 2)
        high = wide * FRONT.rows / FRONT.columns
        seen = (
            (depth_m > _NEAR_M)
            & (np.abs(left_m) < wide * depth_m)
            & (np.abs(up_m) < high * depth_m)
        )
        any_point: Bools = seen.any(axis=1)
        return any_point

"""Where an episode begins: beside the centre line, at an angle, never off the road."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from drsim.arrays import Floats
from drsim.car.car import WHEELS_M
from drsim.track.track import Track

Side = Literal["left", "centre", "right"]

STEP_M = 0.01


class StartPose(NamedTuple):
    """Pose in metres and radians, and the real offset to the left."""

    pose: Floats
    offset_m: float
    on_road: bool


def offset_of(track: Track, fraction: float, side: Side) -> float:
    """Midway between centre line and border of this side, left positive."""
    if side == "centre":
        return 0.0
    distance_m = np.array([fraction * track.length_m])
    centre = track.pose_at(distance_m)[0]
    inside_is_left = track.is_ccw
    lane = track.pose_at(distance_m, "inner" if (side == "left") == inside_is_left else "outer")[0]
    return float((lane[:2] - centre[:2]) @ _leftwards(centre[2]))


def start_pose(track: Track, fraction: float, offset_m: float, angle_deg: float) -> StartPose:
    """The start that was asked for, or the nearest one towards the centre line on the road.

    Offset and angle are to the left.
    """
    centre = track.pose_at(np.array([fraction * track.length_m]))[0]
    yaw = centre[2] + np.radians(angle_deg)
    found = StartPose(np.array([*centre[:2], yaw]), 0.0, False)
    # Outwards, because a neighbouring stretch of the road may lie further out.
    for tried_m in _outwards(offset_m):
        pose = np.array([*(centre[:2] + tried_m * _leftwards(centre[2])), yaw])
        if not _all_wheels_on(track, pose):
            break
        found = StartPose(pose, tried_m, True)
    return found


def _outwards(offset_m: float) -> Sequence[float]:
    steps = math.ceil(abs(offset_m) / STEP_M)
    return [math.copysign(STEP_M * step, offset_m) for step in range(steps)] + [offset_m]


def _leftwards(yaw_rad: float) -> Floats:
    return np.array([-np.sin(yaw_rad), np.cos(yaw_rad)])


def _all_wheels_on(track: Track, pose: Floats) -> bool:
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin], [sin, cos]])
    return bool(track.on_road(pose[:2] + WHEELS_M[:, :2] @ turn.T).all())

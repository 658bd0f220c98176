"""Places all over the road and beside it, as a reward function would be told of them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drcli.rewards.scripted_drive import Drive
from drcli.workers.build_race import MAX_EPISODE_STEPS, SLACK
from drsim.car.car import CONTROL_HZ, REFERENCE_POINT_AHEAD_M, WHEELS_M
from drsim.episode.params import Situation, params_of
from drsim.episode.reward import RewardParams
from drsim.race.objects import Objects
from drsim.race.race import TIME_TRIAL
from drsim.race.traffic import Traffic

Floats = NDArray[np.float64]

SPEED_MPS = 1.5
"""Speed that the action of every place asks for."""

_HALF = (0.11, 0.22, 0.33, 0.44, 0.56, 0.72)
OFFSETS = (*(-offset for offset in reversed(_HALF)), 0.0, *_HALF)
"""Places across the road in widths of it from the centre line, left positive. The road ends midway
between two of them, and all wheels are off it with the outermost."""

_SPACING_M = 0.12
_MOST_ALONG = 400
_SLOWEST_MPS = 0.5


@dataclass(frozen=True)
class Field:
    """Places on the road and beside it, with a car on each that looks along the track.

    Attributes:
        along_m: Distances from waypoint 0. Shape (n,).
        xy: Places, offset by offset. Shape (offsets, n, 2).
        off: All wheels are off the road. Shape (offsets, n).
        objects: Outlines of what stands there, corner by corner. Shape (objects, 4, 2).
        calls: What the reward function is told, offset by offset, without the waypoints.
    """

    along_m: Floats
    xy: Floats
    off: NDArray[np.bool_]
    objects: Floats
    calls: list[RewardParams]


def field(drive: Drive) -> Field:
    """Places all along the lap, as in an episode that drives it at an even speed."""
    track = drive.track
    count = int(min(max(track.length_m / _SPACING_M, 40), _MOST_ALONG))
    along_m = np.linspace(0.0, track.length_m, count, endpoint=False)
    poses = np.tile(track.pose_at(along_m), (len(OFFSETS), 1))
    width_m = np.tile(track.locate(poses[:count, :2]).track_width_m, len(OFFSETS))
    aside_m = np.repeat(OFFSETS, count) * width_m
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    xy = poses[:, :2] + aside_m[:, None] * np.stack([-sin, cos], axis=1)

    turns = np.stack([np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)], axis=1)
    origin = xy - REFERENCE_POINT_AHEAD_M * turns[:, 0]
    wheels_on = track.on_road(origin[:, None] + WHEELS_M[:, :2] @ turns).sum(axis=1)
    off = wheels_on == 0

    part = (along_m / track.length_m - drive.start_fraction) % 1.0
    steps = np.round(2 + part * track.length_m / SPEED_MPS * CONTROL_HZ).astype(np.int64)
    objects, outlines = _objects(drive, len(xy))
    situation = Situation(
        xy=xy,
        heading_deg=np.degrees(poses[:, 2]),
        where=track.locate(xy),
        all_on=wheels_on == len(WHEELS_M),
        none_on=off,
        progress=np.tile(100.0 * part, len(OFFSETS)),
        steps=np.tile(steps, len(OFFSETS)),
        sim_time_s=np.tile(steps / CONTROL_HZ, len(OFFSETS)),
        steering_deg=np.zeros(len(xy)),
        speed_mps=np.full(len(xy), SPEED_MPS),
        backward=np.zeros(len(xy), np.int64),
        crashed=np.zeros(len(xy), np.bool_),
        objects=objects,
    )
    calls = list(params_of((track, track.reversed()), situation, np.arange(len(xy))))
    for call in calls:
        del call["waypoints"]
    shape = (len(OFFSETS), count)
    return Field(along_m, xy.reshape(*shape, 2), off.reshape(shape), outlines, calls)


def unusual(drive: Drive, trip_calls: list[RewardParams]) -> dict[str, RewardParams]:
    """States that trainings meet now and then and a good drive does not, with their names.

    Args:
        drive: The drive.
        trip_calls: What the reward function was told of a driver that kept to the road.
    """
    usual = trip_calls[len(trip_calls) // 2]
    longest = longest_episode(drive)
    return {
        f"after {longest:,} steps": {
            **usual,
            "steps": float(longest),
            "sim_time": longest / CONTROL_HZ,
        },
        "after a day of training": {**usual, "sim_time": 86_400.0},
        "backed over the start line": {**usual, "progress": -0.5},
        "at full lock to the left, 4 m/s": {**usual, "steering_angle": 30.0, "speed": 4.0},
        "at full lock to the right, 0.1 m/s": {**usual, "steering_angle": -30.0, "speed": 0.1},
        "turned round": {**usual, "heading": (usual["heading"] + 360.0) % 360.0 - 180.0},
    }


def longest_episode(drive: Drive) -> int:
    """Steps of the longest episode to reckon with, with slow actions."""
    lap_s = drive.track.length_m / _SLOWEST_MPS
    return min(MAX_EPISODE_STEPS, math.ceil(SLACK * lap_s * CONTROL_HZ))


def _objects(drive: Drive, count: int) -> tuple[Objects | None, Floats]:
    """The objects of the drive at its start, for so many cars, and their outlines."""
    if drive.race == TIME_TRIAL:
        return None, np.empty((0, 4, 2))
    traffic = Traffic((drive.track, drive.track.reversed()), 1, drive.race)
    car = np.zeros(1, np.int64)
    traffic.begin(car, np.array([drive.start_fraction]), car, np.ones(1, np.uint64))
    one = traffic.objects()
    everywhere = Objects(
        xy=np.repeat(one.xy, count, axis=0),
        yaw_rad=np.repeat(one.yaw_rad, count, axis=0),
        footprint_m=one.footprint_m,
        distance_m=np.repeat(one.distance_m, count, axis=0),
        from_center_m=np.repeat(one.from_center_m, count, axis=0),
        left_of_center=np.repeat(one.left_of_center, count, axis=0),
        speed_mps=one.speed_mps,
        tells_heading=one.tells_heading,
    )
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2 * one.footprint_m[:, None]
    cos, sin = np.cos(one.yaw_rad[0])[:, None], np.sin(one.yaw_rad[0])[:, None]
    x, y = corners[..., 0], corners[..., 1]
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return everywhere, one.xy[0][:, None] + turned

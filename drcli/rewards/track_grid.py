"""Calls of a car at places on and off the road."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drcli.rewards.course import Call, Course
from drcli.rewards.sandbox.sample_calls import BESIDE, places
from drcli.rewards.scripted_drive import Drive
from drsim.car.car import CONTROL_HZ, REFERENCE_POINT_AHEAD_M, WHEELS_M
from drsim.episode.params import Situation, params_of
from drsim.race.objects import Objects
from drsim.race.race import TIME_TRIAL
from drsim.race.traffic import Traffic
from drsim.track.ways import Ways

Floats = NDArray[np.float64]

SPEED_MPS = 1.5
_HALF = (0.11, 0.22, 0.33, 0.44, 0.56, 0.72)
OFFSETS = (*(-offset for offset in reversed(_HALF)), BESIDE, *_HALF)
"""To the left, in road widths. The border is midway between two; at the outermost, all wheels are
off the road.
"""

_TURNED_DEG = 0.6
"""Seen by the function only: no car is exactly parallel to the road."""

_SPACING_M = 0.12
_MOST_ALONG = 400


@dataclass(frozen=True)
class Grid:
    """Cars that point along the track.

    Attributes:
        xy: Shape (offsets, n, 2).
        off: All wheels are off the road. Shape (offsets, n).
        objects: Corners. Shape (objects, 4, 2).
        calls: Offset by offset, without waypoints.
    """

    xy: Floats
    off: NDArray[np.bool_]
    objects: Floats
    calls: list[Call]


def track_grid(drive: Drive) -> Grid:
    """An episode at constant speed."""
    track = drive.track
    count = int(min(max(track.length_m / _SPACING_M, 40), _MOST_ALONG))
    along_m = np.linspace(0.0, track.length_m, count, endpoint=False)
    xy, yaw_rad = places(track, along_m, OFFSETS)

    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turns = np.stack([np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)], axis=1)
    origin = xy - REFERENCE_POINT_AHEAD_M * turns[:, 0]
    wheels_on = track.on_road(origin[:, None] + WHEELS_M[:, :2] @ turns).sum(axis=1)
    off = wheels_on == 0

    part = (along_m / track.length_m - drive.start_fraction) % 1.0
    steps = np.round(2 + part * track.length_m / SPEED_MPS * CONTROL_HZ).astype(np.int64)
    objects, outlines = _objects(drive, len(xy))
    situation = Situation(
        xy=xy,
        heading_deg=(np.degrees(yaw_rad) + _TURNED_DEG + 180.0) % 360.0 - 180.0,
        where=track.locate(xy),
        all_on=wheels_on == len(WHEELS_M),
        none_on=off,
        progress=np.tile(100.0 * part, len(OFFSETS)),
        steps=np.tile(steps, len(OFFSETS)),
        sim_time_s=np.tile(steps / CONTROL_HZ, len(OFFSETS)),
        steering_deg=np.zeros(len(xy)),
        speed_mps=np.full(len(xy), SPEED_MPS),
        way=np.zeros(len(xy), np.int64),
        crashed=np.zeros(len(xy), np.bool_),
        objects=objects,
    )
    calls = list(params_of((track, track.reversed()), situation, np.arange(len(xy))))
    for call in calls:
        del call["waypoints"]
    shape = (len(OFFSETS), count)
    return Grid(xy.reshape(*shape, 2), off.reshape(shape), outlines, calls)


def _objects(drive: Drive, count: int) -> tuple[Objects | None, Floats]:
    if drive.race == TIME_TRIAL:
        return None, np.empty((0, 4, 2))
    traffic = Traffic(Ways([drive.track], 1), drive.race)
    car = np.zeros(1, np.int64)
    traffic.begin(car, np.array([drive.start_fraction]), np.ones(1, np.uint64))
    one = traffic.objects()
    of_each_car = ("xy", "yaw_rad", "distance_m", "from_center_m", "left_of_center")
    repeated = {name: np.repeat(getattr(one, name), count, axis=0) for name in of_each_car}
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2 * one.footprint_m[:, None]
    cos, sin = np.cos(one.yaw_rad[0])[:, None], np.sin(one.yaw_rad[0])[:, None]
    x, y = corners[..., 0], corners[..., 1]
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return one._replace(**repeated), one.xy[0][:, None] + turned


@dataclass(frozen=True)
class DrivenCourse:
    """A course with what a picture of it shows besides."""

    drive: Drive
    grid: Grid

    @staticmethod
    def of(drive: Drive) -> "DrivenCourse":
        return DrivenCourse(drive, track_grid(drive))

    @property
    def course(self) -> Course:
        drive = self.drive
        waypoints = drive.waypoints()
        return Course(
            drive.world,
            drive.race_type,
            drive.track.reverse,
            drive.track.length_m,
            [waypoints[way] for way in (False, True)],
            drive.trips,
            self.grid.calls,
            self.grid.off.tolist(),
        )

"""Track columns of recordings (progress, closest waypoint ...), derived again from the poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drsim.arrays import Bools, Floats
from drsim.car.car import REFERENCE_POINT_AHEAD_M, CarBatch
from drsim.episode.episode_rules import advance_progress
from drsim.fidelity.recordings import Recording
from drsim.track.polyline import Location
from drsim.track.track import Track

PROGRESS_TOLERANCE = 0.02
"""Percent of a lap; 3 mm of a short one."""

_LENGTH_TOLERANCE = 0.01
_FURTHEST_M = 2.0


@dataclass(frozen=True)
class Agreement:
    """Shares of recorded rows whose columns agree, 0 .. 1; NaN where the column is missing.

    Attributes:
        progress: Within `PROGRESS_TOLERANCE`; others are equal.
        reverse: Driven against the direction of the track.
        fits: The recording may be of this track.
    """

    progress: float
    closest_waypoint: float
    all_wheels_on_track: float
    rows: int
    length_m: float
    recorded_length_m: float
    reverse: bool
    fits: bool


def compare_track_columns(drives: Sequence[Recording], track: Track) -> Agreement:
    poses = np.concatenate([drive.poses for drive in drives])
    waypoint = np.concatenate([drive.waypoint for drive in drives])
    wheels_on = np.concatenate([drive.wheels_on for drive in drives])
    lengths_m = np.array([drive.track_length_m for drive in drives])
    lengths_m = lengths_m[np.isfinite(lengths_m)]
    recorded_m = float(np.median(lengths_m)) if len(lengths_m) else float("nan")

    ways = [(way, way.locate(poses[:, :2])) for way in (track, track.reversed())]
    way, where = max(ways, key=lambda both: np.mean(both[1].nearest == waypoint))
    known = wheels_on >= 0
    on = all_wheels_on(poses[known], way)
    near_m = float(np.median(where.from_center_m))
    too_long = abs(recorded_m - track.length_m) > _LENGTH_TOLERANCE * track.length_m
    return Agreement(
        progress=_share(np.abs(_progress_errors(drives, where, way)) <= PROGRESS_TOLERANCE),
        closest_waypoint=_share((where.nearest == waypoint)[waypoint >= 0]),
        all_wheels_on_track=_share(on == wheels_on[known]),
        rows=len(poses),
        length_m=track.length_m,
        recorded_length_m=recorded_m,
        reverse=way.reverse != track.reverse,
        fits=near_m <= _FURTHEST_M and not too_long,
    )


def all_wheels_on(poses: Floats, track: Track) -> Bools:
    """Whether all four wheels of standing cars are on the road; poses as in `Recording`."""
    if not len(poses):
        return np.zeros(0, np.bool_)
    yaw = poses[:, 2]
    ahead_m = REFERENCE_POINT_AHEAD_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    cars = CarBatch(len(poses), 1)
    cars.place(np.arange(len(poses)), np.column_stack([poses[:, :2] - ahead_m, yaw]))
    return np.asarray(np.all(track.on_road(cars.wheel_xy), axis=1))


def _progress_errors(drives: Sequence[Recording], where: Location, track: Track) -> Floats:
    fraction = where.distance_m / track.length_m
    errors, row = [np.empty(0)], 0
    for drive in drives:
        recorded, here = drive.progress, fraction[row : row + len(drive.progress)]
        row += len(recorded)
        start = np.full(len(recorded), here[0] - recorded[0] / 100.0) % 1.0
        before = np.where(recorded >= 100.0, 0.0, recorded)[:-1]
        found = advance_progress(before, here[1:], start[1:])
        errors.append((found - recorded[1:])[np.isfinite(recorded[1:] + before)])
    return np.concatenate(errors)


def _share(right: Bools) -> float:
    return float(right.mean()) if len(right) else float("nan")

"""A driver for the tests of tracks: steers each car to a point ahead of it on its centre line."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from drsim.car.car import CarBatch
from drsim.track.track import Track

AHEAD_M = 0.45
WHEELBASE_M = 0.164
START_M = 0.3
"""Far enough from the end of an open track for all four wheels to stand on it."""


@dataclass(frozen=True)
class Drive:
    """Metres made along each centre line, and which cars put a wheel beside the road."""

    progress_m: np.ndarray
    off_road: np.ndarray


Follow = Callable[..., Drive]


@pytest.fixture
def follow() -> Follow:
    """Drive one car a track from its start, all of them in one batch."""

    def drive(tracks: list[Track], *, speed_mps: float, steps: int) -> Drive:
        cars = CarBatch(len(tracks), num_threads=1)
        starts = np.concatenate([track.pose_at(np.full(1, START_M)) for track in tracks])
        cars.place(np.arange(len(tracks)), starts)
        length_m = np.array([track.length_m for track in tracks])
        closed = np.array([track.closed for track in tracks])
        at_m, progress_m = np.full(len(tracks), START_M), np.zeros(len(tracks))
        off_road = np.zeros(len(tracks), dtype=np.bool_)
        for _ in range(steps):
            targets = np.concatenate(
                [track.pose_at(at_m[k : k + 1] + AHEAD_M) for k, track in enumerate(tracks)]
            )
            apart = targets[:, :2] - cars.origin_xy
            bearing_rad = np.arctan2(apart[:, 1], apart[:, 0]) - cars.yaw_rad
            curvature = 2 * np.sin(bearing_rad) / np.hypot(*apart.T)
            cars.drive(
                np.degrees(np.arctan(WHEELBASE_M * curvature)), np.full(len(tracks), speed_mps)
            )
            for k, track in enumerate(tracks):
                off_road[k] |= not track.on_road(cars.wheel_xy[k]).all()
            now_m = np.array(
                [
                    track.locate(cars.origin_xy[k : k + 1]).distance_m[0]
                    for k, track in enumerate(tracks)
                ]
            )
            step_m = now_m - at_m
            around_m = (step_m + length_m / 2) % length_m - length_m / 2
            progress_m += np.where(closed, around_m, step_m)
            at_m = now_m
        return Drive(progress_m, off_road)

    return drive

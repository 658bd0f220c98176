"""The parameters of a reward function: 27 keys, which must keep their names and meaning."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drsim.episode.reward import RewardParams
from drsim.race.objects import Objects
from drsim.track.polyline import Location
from drsim.track.track import Track

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Situation:
    """Where each car is and what it was asked to do; arrays over cars.

    All track quantities belong to the point 0.14 m ahead of the car's origin.

    Attributes:
        xy: That point in the world, metres. Shape (n, 2).
        heading_deg: Yaw of the car, -180 .. 180. Shape (n,).
        where: Where that point lies relative to the track.
        all_on: All four wheel centres are on the track. Shape (n,).
        none_on: No wheel centre is on the track. Shape (n,).
        progress: Percent of the lap. Shape (n,).
        steps: Steps of the episode, the first included. Shape (n,).
        sim_time_s: Clock of the simulation. Shape (n,).
        steering_deg: Angle asked for, not clipped. Shape (n,).
        speed_mps: Speed asked for, not clipped. Shape (n,).
        backward: Index into the tracks: 1 for a car that drives the lap the other way. Shape (n,).
        crashed: The car has driven into something, and that has consequences. Shape (n,).
        objects: What else is on the track; None where a car is alone.
    """

    xy: Floats
    heading_deg: Floats
    where: Location
    all_on: Bools
    none_on: Bools
    progress: Floats
    steps: NDArray[np.int64]
    sim_time_s: Floats
    steering_deg: Floats
    speed_mps: Floats
    backward: NDArray[np.int64]
    crashed: Bools
    objects: Objects | None = None


def params_of(
    tracks: Sequence[Track], situation: Situation, cars: NDArray[np.int64]
) -> Iterator[RewardParams]:
    """Build the dictionaries of some cars, one at a time.

    Every dictionary is fresh, lists included, so that a reward function may alter what it gets.

    Args:
        tracks: The track as given and, where cars drive both ways, the reversed one.
        situation: All cars.
        cars: The cars wanted. Shape (k,).

    Yields:
        The parameters of each car, in the order given, as plain Python values.
    """
    s, where = situation, situation.where
    driven = [tracks[direction] for direction in s.backward[cars].tolist()]
    x, y = s.xy[cars].T.tolist()
    columns: dict[str, Iterable[Any]] = {
        "all_wheels_on_track": s.all_on[cars].tolist(),
        "x": x,
        "y": y,
        "heading": s.heading_deg[cars].tolist(),
        "distance_from_center": where.from_center_m[cars].tolist(),
        "projection_distance": where.distance_m[cars].tolist(),
        "progress": s.progress[cars].tolist(),
        "steps": map(float, s.steps[cars].tolist()),
        "speed": s.speed_mps[cars].tolist(),
        "steering_angle": s.steering_deg[cars].tolist(),
        "track_width": where.track_width_m[cars].tolist(),
        "track_length": [track.length_m for track in driven],
        "waypoints": map(list, [track.waypoints for track in driven]),
        "closest_waypoints": _pairs(where.previous[cars], where.next[cars]),
        "is_left_of_center": where.left_of_center[cars].tolist(),
        "is_reversed": [track.reverse for track in driven],
        "closest_objects": [[0, 0] for _ in driven],
        "objects_location": [[] for _ in driven],
        "objects_left_of_center": [[] for _ in driven],
        "object_in_camera": repeat(False, len(driven)),
        "objects_speed": [[] for _ in driven],
        "objects_heading": [[] for _ in driven],
        "objects_distance_from_center": [[] for _ in driven],
        "objects_distance": [[] for _ in driven],
        "is_crashed": s.crashed[cars].tolist(),
        "is_offtrack": s.none_on[cars].tolist(),
        "sim_time": s.sim_time_s[cars].tolist(),
    }
    if s.objects is not None and len(s.objects.speed_mps):
        columns |= _columns_of_objects(s.objects, s, cars)
    names = tuple(columns)
    for values in zip(*columns.values(), strict=True):
        yield dict(zip(names, values))  # noqa: B905  a fifth faster, and the lengths are equal


def _columns_of_objects(o: Objects, s: Situation, cars: NDArray[np.int64]) -> dict[str, Any]:
    """The eight keys about objects: a value for each of the cars."""
    previous, following = o.closest(cars, s.where.distance_m[cars])
    seen = o.in_camera(cars, following, s.xy[cars], np.radians(s.heading_deg[cars]))
    speeds = o.speed_mps.tolist()
    return {
        "closest_objects": _pairs(previous, following),
        "objects_location": o.xy[cars].tolist(),
        "objects_left_of_center": o.left_of_center[cars].tolist(),
        "object_in_camera": seen.tolist(),
        "objects_speed": [list(speeds) for _ in previous],
        "objects_heading": np.where(o.tells_heading, o.yaw_rad[cars], 0.0).tolist(),
        "objects_distance_from_center": o.from_center_m[cars].tolist(),
        "objects_distance": o.distance_m[cars].tolist(),
    }


def _pairs(one: NDArray[np.int64], other: NDArray[np.int64]) -> Iterable[list[int]]:
    return map(list, zip(one.tolist(), other.tolist(), strict=True))

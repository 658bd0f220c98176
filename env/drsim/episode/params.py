"""The parameters a reward function is given: 27 keys whose names and meaning the users own."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drsim.episode.reward import RewardParams
from drsim.race.objects import Objects
from drsim.track.track import Location, Track

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Situation:
    """Where each car is and what it was asked to do; arrays over cars.

    All track quantities belong to the point 0.14 m ahead of the car's origin.

    Attributes:
        xy: That point in the world, metres. Shape (n, 2).
        heading_deg: Yaw of the car, -180 .. 180. Shape (n,).
        where: That point seen from the centre line.
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
    columns = zip(
        s.backward[cars].tolist(),
        s.all_on[cars].tolist(),
        s.none_on[cars].tolist(),
        s.xy[cars].tolist(),
        s.heading_deg[cars].tolist(),
        where.from_center_m[cars].tolist(),
        where.distance_m[cars].tolist(),
        s.progress[cars].tolist(),
        s.steps[cars].tolist(),
        s.speed_mps[cars].tolist(),
        s.steering_deg[cars].tolist(),
        where.track_width_m[cars].tolist(),
        where.previous[cars].tolist(),
        where.next[cars].tolist(),
        where.left_of_center[cars].tolist(),
        s.sim_time_s[cars].tolist(),
        s.crashed[cars].tolist(),
        strict=True,
    )
    objects = None
    if s.objects is not None and len(s.objects.speed_mps):
        objects = _rows_of_objects(s.objects, s, cars)
    for (
        direction,
        all_on,
        none_on,
        (x, y),
        heading_deg,
        from_center_m,
        distance_m,
        progress,
        steps,
        speed_mps,
        steering_deg,
        width_m,
        previous,
        following,
        left,
        sim_time_s,
        crashed,
    ) in columns:
        track = tracks[direction]
        params = {
            "all_wheels_on_track": all_on,
            "x": x,
            "y": y,
            "heading": heading_deg,
            "distance_from_center": from_center_m,
            "projection_distance": distance_m,
            "progress": progress,
            "steps": float(steps),
            "speed": speed_mps,
            "steering_angle": steering_deg,
            "track_width": width_m,
            "track_length": track.length_m,
            "waypoints": list(track.waypoints),
            "closest_waypoints": [previous, following],
            "is_left_of_center": left,
            "is_reversed": track.reverse,
            "closest_objects": [0, 0],
            "objects_location": [],
            "objects_left_of_center": [],
            "object_in_camera": False,
            "objects_speed": [],
            "objects_heading": [],
            "objects_distance_from_center": [],
            "objects_distance": [],
            "is_crashed": crashed,
            "is_offtrack": none_on,
            "sim_time": sim_time_s,
        }
        if objects is not None:
            params.update(next(objects))
        yield params


def _rows_of_objects(o: Objects, s: Situation, cars: NDArray[np.int64]) -> Iterator[RewardParams]:
    """The eight keys about objects, for one car after the other."""
    previous, following = o.closest(cars, s.where.distance_m[cars])
    seen = o.in_camera(cars, following, s.xy[cars], np.radians(s.heading_deg[cars]))
    speed_mps = o.speed_mps.tolist()
    columns = zip(
        previous.tolist(),
        following.tolist(),
        o.xy[cars].tolist(),
        o.left_of_center[cars].tolist(),
        seen.tolist(),
        np.where(o.tells_heading, o.yaw_rad[cars], 0.0).tolist(),
        o.from_center_m[cars].tolist(),
        o.distance_m[cars].tolist(),
        strict=True,
    )
    for before, after, location, left, in_camera, heading_rad, from_center_m, distance_m in columns:
        yield {
            "closest_objects": [before, after],
            "objects_location": location,
            "objects_left_of_center": left,
            "object_in_camera": in_camera,
            "objects_speed": list(speed_mps),
            "objects_heading": heading_rad,
            "objects_distance_from_center": from_center_m,
            "objects_distance": distance_m,
        }

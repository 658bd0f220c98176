"""The 27 parameters of a reward function, which must keep their names and meaning."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.episode.reward import RewardParams
from drsim.race.objects import Objects, closest, in_camera
from drsim.track.polyline import Location
from drsim.track.track import Track


@dataclass(frozen=True)
class Situation:
    """Where each car is and what it was asked to do. Shape (n,) unless given.

    Track quantities belong to the point 0.14 m ahead of the car's origin.

    Attributes:
        xy: That point, metres. Shape (n, 2).
        heading_deg: -180 .. 180.
        all_on: All four wheel centres are on the track.
        steering_deg: Like the speed, asked for, not clipped.
        way: Index into the tracks that `params_of` gets.
        objects: None where a car is alone.
    """

    xy: Floats
    heading_deg: Floats
    where: Location
    all_on: Bools
    none_on: Bools
    progress: Floats
    steps: Ints
    sim_time_s: Floats
    steering_deg: Floats
    speed_mps: Floats
    way: Ints
    crashed: Bools
    objects: Objects | None = None


def params_of(tracks: Sequence[Track], situation: Situation, cars: Ints) -> Iterator[RewardParams]:
    """Build the dictionaries of some cars, one at a time, of plain Python values.

    All are fresh, lists included, so that a reward function may alter them.
    """
    s, where = situation, situation.where
    xy, heading_deg = s.xy.tolist(), s.heading_deg.tolist()
    all_on, none_on = s.all_on.tolist(), s.none_on.tolist()
    progress, steps, sim_time_s = s.progress.tolist(), s.steps.tolist(), s.sim_time_s.tolist()
    steering_deg, speed_mps = s.steering_deg.tolist(), s.speed_mps.tolist()
    way, crashed = s.way.tolist(), s.crashed.tolist()
    distance_m, width_m = where.distance_m.tolist(), where.track_width_m.tolist()
    from_center_m, left = where.from_center_m.tolist(), where.left_of_center.tolist()
    previous, following = where.previous.tolist(), where.next.tolist()
    objects = None
    if s.objects is not None and len(s.objects.speed_mps):
        objects = _params_of_objects(s.objects, s, cars)
    for car in cars.tolist():
        track = tracks[way[car]]
        params = {
            "all_wheels_on_track": all_on[car],
            "x": xy[car][0],
            "y": xy[car][1],
            "heading": heading_deg[car],
            "distance_from_center": from_center_m[car],
            "projection_distance": distance_m[car],
            "progress": progress[car],
            "steps": float(steps[car]),
            "speed": speed_mps[car],
            "steering_angle": steering_deg[car],
            "track_width": width_m[car],
            "track_length": track.length_m,
            "waypoints": track.waypoints.copy(),
            "closest_waypoints": [previous[car], following[car]],
            "is_left_of_center": left[car],
            "is_reversed": track.reverse,
            "closest_objects": [0, 0],
            "objects_location": [],
            "objects_left_of_center": [],
            "object_in_camera": False,
            "objects_speed": [],
            "objects_heading": [],
            "objects_distance_from_center": [],
            "objects_distance": [],
            "is_crashed": crashed[car],
            "is_offtrack": none_on[car],
            "sim_time": sim_time_s[car],
        }
        if objects is not None:
            params |= next(objects)
        yield params


def _params_of_objects(o: Objects, s: Situation, cars: Ints) -> Iterator[RewardParams]:
    previous, following = closest(o.distance_m, cars, s.where.distance_m[cars])
    seen = in_camera(o[:3], cars, following, s.xy[cars], np.radians(s.heading_deg[cars]))
    speed_mps, xy, left = o.speed_mps.tolist(), o.xy.tolist(), o.left_of_center.tolist()
    heading_rad = np.where(o.tells_heading, o.yaw_rad, 0.0).tolist()
    from_center_m, distance_m = o.from_center_m.tolist(), o.distance_m.tolist()
    pairs = zip(previous.tolist(), following.tolist(), strict=True)
    for car, pair, visible in zip(cars.tolist(), pairs, seen.tolist(), strict=True):
        yield {
            "closest_objects": list(pair),
            "objects_location": xy[car],
            "objects_left_of_center": left[car],
            "object_in_camera": visible,
            "objects_speed": speed_mps.copy(),
            "objects_heading": heading_rad[car],
            "objects_distance_from_center": from_center_m[car],
            "objects_distance": distance_m[car],
        }

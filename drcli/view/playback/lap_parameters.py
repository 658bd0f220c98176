"""Reward parameters at each step of a recorded lap."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from drcli.view.video.recorded_lap import JUMP_M, RecordedLap
from drsim.arrays import Floats
from drsim.car.car import REFERENCE_POINT_AHEAD_M, WHEELS_M
from drsim.episode.params import Situation, params_of
from drsim.race.objects import Objects
from drsim.race.solids import Shape
from drsim.track.track import Track

OBJECT_KEYS = (
    "closest_objects",
    "objects_location",
    "objects_left_of_center",
    "object_in_camera",
    "objects_speed",
    "objects_heading",
    "objects_distance_from_center",
    "objects_distance",
)

_CONSTANT = ("track_length", "is_reversed")

_BOXES = "box_obstacle"


@dataclass(frozen=True)
class LapParameters:
    """Parameters of some steps.

    Attributes:
        constants: Those equal at every step.
        unknown: Why others cannot be known.
    """

    columns: dict[str, list[Any]]
    constants: dict[str, Any]
    unknown: dict[str, str]


@dataclass(frozen=True)
class KnownRace:
    """What is known about a trace's race.

    Attributes:
        race_type: As DR_RACE_TYPE, or empty.
        reverse: None if not recorded.
    """

    race_type: str
    shapes: tuple[Shape, ...] = ()
    reverse: bool | None = None


def directed_track(track: Track, lap: RecordedLap, race: KnownRace) -> Track:
    """In the lap's direction, measured where not recorded."""
    backward = _drove_backward(track, lap)
    if backward is None:
        backward = bool(race.reverse)
    return track.reversed() if backward else track


def lap_parameters(
    track: Track, lap: RecordedLap, race: KnownRace, first: int, count: int
) -> LapParameters:
    """Of `count` steps from row `first`; `track` as from `directed_track`."""
    rows = slice(first, first + count)
    poses = lap.poses[rows]
    xy = _front(poses)
    on = track.on_road(_wheels(poses)).sum(axis=1)
    recorded = lap.on_track[rows]
    all_on = np.array(
        [bool(on[k] == 4) if recorded[k] is None else recorded[k] for k in range(len(poses))], bool
    )
    objects, unknown = _objects(track, lap, race, rows)
    # A trace counts steps from 1; numbers of a damaged one may be anything.
    steps = np.clip(np.nan_to_num(lap.steps[rows]), 0, 1e9).astype(np.int64)
    heading = np.degrees(poses[:, 2])
    situation = Situation(
        xy=xy,
        heading_deg=(heading + 180.0) % 360.0 - 180.0,
        where=track.locate(xy),
        all_on=all_on,
        none_on=(on == 0) & ~all_on,
        progress=lap.progress[rows],
        steps=steps,
        sim_time_s=lap.clock_s[rows],
        steering_deg=lap.steering_deg[rows],
        speed_mps=lap.speed_mps[rows],
        way=np.zeros(len(poses), np.int64),
        crashed=np.array([each == "crashed" for each in lap.status[rows]]),
        objects=objects,
    )
    everything = list(params_of((track,), situation, np.arange(len(poses))))
    unknown["sim_time"] = (
        "The clock of the car is not in a trace, which counts the time from the start of the "
        "episode."
    )
    names = [name for name in (everything[0] if everything else ()) if name not in unknown]
    columns = {name: [each[name] for each in everything] for name in names}
    columns.pop("waypoints", None)
    constants = {name: columns.pop(name)[0] for name in _CONSTANT if name in columns}
    return LapParameters(columns, constants, unknown)


def _objects(
    track: Track, lap: RecordedLap, race: KnownRace, rows: slice
) -> tuple[Objects | None, dict[str, str]]:
    poses = lap.objects[rows]
    if not race.shapes:
        if race.race_type == "TIME_TRIAL":
            return None, {}
        why = (
            f"The objects of a {race.race_type} training are not recorded."
            if race.race_type
            else "Nobody recorded whether there were objects on the track."
        )
        return None, dict.fromkeys(OBJECT_KEYS, why)
    count = len(race.shapes)
    flat = np.ascontiguousarray(poses[:, :, :2].reshape(-1, 2))
    where = track.locate(flat)
    shape = (len(poses), count)
    boxes = np.array([_BOXES in each.name for each in race.shapes])
    moving = race.race_type == "HEAD_TO_BOT"
    objects = Objects(
        xy=poses[:, :, :2],
        yaw_rad=poses[:, :, 2],
        footprint_m=np.array([each.footprint_m for each in race.shapes], np.float64),
        distance_m=where.distance_m.reshape(shape),
        from_center_m=where.from_center_m.reshape(shape),
        left_of_center=where.left_of_center.reshape(shape),
        speed_mps=np.zeros(count),
        tells_heading=~boxes,
    )
    if not moving:
        return objects, {}
    why = "The speed that bots were told to drive is not recorded."
    return objects, {"objects_speed": why}


def _front(poses: Floats) -> Floats:
    """The x and y of reward functions. Shape (t, 2)."""
    ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    return poses[:, :2] + REFERENCE_POINT_AHEAD_M * ahead


def _wheels(poses: Floats) -> Floats:
    """Centres, at rest. Shape (t, 4, 2)."""
    cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = WHEELS_M[None, :, 0], WHEELS_M[None, :, 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=2) + poses[:, None, :2]


def _drove_backward(track: Track, lap: RecordedLap) -> bool | None:
    """Progress rose against the track; None if the car hardly moved."""
    along_m = track.locate(_front(lap.poses)).distance_m
    moved_m, progressed = np.diff(along_m), np.diff(lap.progress)
    if track.closed:
        half = track.length_m / 2.0
        moved_m = (moved_m + half) % track.length_m - half
    near = np.abs(moved_m) < JUMP_M
    agrees = float(np.sum((moved_m * np.sign(progressed))[near]))
    if abs(agrees) < 0.05:
        return None
    return agrees < 0.0

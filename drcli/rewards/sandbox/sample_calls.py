"""The calls that every check of a reward function makes."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import Problem, ProblemsError
from drcli.config.run_config import DriveConfig
from drcli.drive.build_race import MAX_EPISODE_STEPS, SLACK, load_race, load_world, race_warnings
from drsim.car.car import CONTROL_HZ
from drsim.episode.params import Situation, params_of
from drsim.episode.reward import RewardParams
from drsim.race.race import TIME_TRIAL, Race
from drsim.race.traffic import Traffic
from drsim.track.track import Track
from drsim.track.ways import Ways
from drsim.track.worlds import load_track

POSITIONS = 40
OFFSETS = (0.0, 0.3, -0.3, 1.0)
"""To the left, in road widths."""

Floats = NDArray[np.float64]

_STATES = (0, POSITIONS // 4, POSITIONS // 2, 3 * POSITIONS + POSITIONS // 4, POSITIONS - 1)
"""Tried first: start line, road, half a lap, off the track, finish. Source: the console's
validator. The first is an episode's first call, where functions set up variables.
"""

FIRST_UNUSUAL = LATE = -6
_SPEED_MPS, _SLOWEST_MPS = 1.0, 0.5

_FALLBACK_WORLD = "reinvent_base"


def sample_races(
    races: Sequence[DriveConfig],
) -> tuple[list[list[RewardParams]], list[str], list[Problem]]:
    """Samples of each distinct race, and why races cannot be loaded."""
    problems: list[Problem] = []
    samples: dict[tuple[str, Race], list[RewardParams]] = {}
    names = []
    for own in races:
        try:
            track = load_world(own)
            race = load_race(own, track)
        except ProblemsError as error:
            problems += error.problems
            continue
        if (own.world_name, race) not in samples:
            problems += race_warnings(own, track, race)
            samples[own.world_name, race] = sample_params(track, race)
            names.append(f"{own.world_name}, {own.race_type}")
    if not samples:
        return [sample_params(load_track(_FALLBACK_WORLD))], [_FALLBACK_WORLD], problems
    return list(samples.values()), names, problems


def sample_params(track: Track, race: Race = TIME_TRIAL) -> list[RewardParams]:
    """Parameters all along a lap, on and off the track, then six states of long trainings."""
    count = POSITIONS * len(OFFSETS)
    fraction = np.tile(np.linspace(0.0, 1.0, POSITIONS, endpoint=False), len(OFFSETS))
    xy, yaw_rad = places(track, fraction[:POSITIONS] * track.length_m, OFFSETS)
    off = np.repeat([abs(offset) > 0.5 for offset in OFFSETS], POSITIONS)
    progress = 100.0 * fraction
    progress[POSITIONS - 1] = 100.0  # at the finish
    situation = Situation(
        xy=xy,
        heading_deg=np.degrees(yaw_rad),
        where=track.locate(xy),
        all_on=~off,
        none_on=off,
        progress=progress,
        steps=np.arange(2, count + 2),
        sim_time_s=np.arange(count) / CONTROL_HZ,
        steering_deg=np.zeros(count),
        speed_mps=np.full(count, _SPEED_MPS),
        way=np.zeros(count, np.int64),
        crashed=off & (race != TIME_TRIAL),  # so that crashes are tried as well
    )
    ways = Ways([track], count)
    if race != TIME_TRIAL:
        traffic = Traffic(ways, race)
        traffic.begin(np.arange(count), fraction, np.arange(count, dtype=np.uint64))
        situation = replace(situation, objects=traffic.objects())
    samples = list(params_of(ways.tracks, situation, np.arange(count)))
    rest = [params for index, params in enumerate(samples) if index not in _STATES]
    return [*(samples[index] for index in _STATES), *rest, *_unusual(track, samples)]


def _unusual(track: Track, samples: Sequence[RewardParams]) -> list[RewardParams]:
    """A very long episode, a day of training, driving back, extreme actions, the wrong way.

    Few trainings meet them, so failures only there do not refuse a start.
    """
    usual = samples[POSITIONS // 2]
    slow_lap_s = track.length_m / _SLOWEST_MPS
    longest = min(MAX_EPISODE_STEPS, math.ceil(SLACK * slow_lap_s * CONTROL_HZ))
    return [
        {**usual, "steps": float(longest), "sim_time": longest / CONTROL_HZ},
        {**usual, "sim_time": 86_400.0},
        {**usual, "progress": -0.5},
        {**usual, "steering_angle": 30.0, "speed": 4.0},
        {**usual, "steering_angle": -30.0, "speed": 0.1},
        {**usual, "heading": (usual["heading"] + 360.0) % 360.0 - 180.0},
    ]


def state_of(call: RewardParams, race: str = "") -> str:
    """The state in words; `race` as of `sample_races`."""
    if call["is_offtrack"]:
        where = "off the track"
    elif call["progress"] >= 100.0:
        where = "at the finish"
    else:
        where = "on the start line" if call["steps"] <= 2 else "on the road"
    step = f"step {call['steps']:,.0f}, {call['progress']:.1f} % of the lap"
    return f"{where} ({race}, {step})" if race else f"{where} ({step})"


def places(track: Track, along_m: Floats, offsets: Sequence[float]) -> tuple[Floats, Floats]:
    """Places, shape (m * n, 2), and directions in radians, shape (m * n,), offset by offset.

    Args:
        track: The track.
        along_m: From waypoint 0. Shape (n,).
        offsets: To the left, in road widths. Shape (m,).
    """
    poses = np.tile(track.pose_at(along_m), (len(offsets), 1))
    width_m = np.tile(track.locate(poses[: len(along_m), :2]).track_width_m, len(offsets))
    yaw_rad = poses[:, 2]
    left = np.stack([-np.sin(yaw_rad), np.cos(yaw_rad)], axis=1)
    return poses[:, :2] + left * (np.repeat(offsets, len(along_m)) * width_m)[:, None], yaw_rad

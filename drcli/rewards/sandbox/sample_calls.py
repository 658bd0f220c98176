"""The calls that every check of a reward function makes."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import Problem, ProblemsError
from drcli.config.run_config import DriveConfig
from drcli.drive.build_race import MAX_EPISODE_STEPS, SLACK, load_race, load_world, race_warnings
from drcli.rewards.course import LATE
from drsim.car.actions import DEFAULT_ACTIONS, Actions, DiscreteActions
from drsim.car.car import CONTROL_HZ
from drsim.episode.params import Situation, params_of
from drsim.episode.reward import RewardParams
from drsim.race.race import TIME_TRIAL, Race
from drsim.race.traffic import Traffic
from drsim.track.track import Track
from drsim.track.ways import Ways
from drsim.track.worlds import load_track

POSITIONS = 40
BESIDE = 0.01
"""Road widths from the centre line: no car is exactly on it."""

OFFSETS = (BESIDE, 0.3, -0.3, 1.0)
"""To the left, in road widths."""

_TURNED_DEG = (1.7, -0.6, 4.3, -2.9)

Floats = NDArray[np.float64]

FIRST_UNUSUAL = LATE - 1
_PACE_MPS, _SLOWEST_MPS = 1.5, 0.5
_FIRST_M = 0.14
"""From the start to the place of an episode's first call."""

_STEP_M = _PACE_MPS / CONTROL_HZ
_PAST_M = 0.01
LAST_WAYPOINTS = 3

_FALLBACK_WORLD = "reinvent_base"


def sample_races(
    races: Sequence[DriveConfig], actions: Actions | None = None
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
            samples[own.world_name, race] = sample_params(track, race, actions)
            names.append(f"{own.world_name}, {own.race_type}")
    if not samples:
        return (
            [sample_params(load_track(_FALLBACK_WORLD), actions=actions)],
            [_FALLBACK_WORLD],
            problems,
        )
    return list(samples.values()), names, problems


def sample_params(
    track: Track, race: Race = TIME_TRIAL, actions: Actions | None = None
) -> list[RewardParams]:
    """Parameters of a lap for each offset, then states of long trainings.

    Each place has two calls, the second a step after the first, as in a training; `is_sudden` tells
    which are first calls. The actions are taken in turn.
    """
    lap_m = _along_m(track)
    count = len(lap_m) * len(OFFSETS)
    along_m = np.tile(lap_m, len(OFFSETS))
    xy, yaw_rad = places(track, lap_m, OFFSETS)
    off = np.repeat([abs(offset) > 0.5 for offset in OFFSETS], len(lap_m))
    steps = 2 + np.round((along_m - _FIRST_M) / _STEP_M).astype(np.int64)
    choices = np.array(_choices(actions))[np.arange(count) // 2 % len(_choices(actions))]
    turned_deg = np.array(_TURNED_DEG)[np.arange(count) // 2 % len(_TURNED_DEG)]
    situation = Situation(
        xy=xy,
        heading_deg=(np.degrees(yaw_rad) + turned_deg + 180.0) % 360.0 - 180.0,
        where=track.locate(xy),
        all_on=~off,
        none_on=off,
        progress=np.minimum(100.0 * along_m / track.length_m, 100.0),
        steps=steps,
        sim_time_s=steps / CONTROL_HZ,
        steering_deg=choices[:, 0],
        speed_mps=choices[:, 1],
        way=np.zeros(count, np.int64),
        crashed=off & (race != TIME_TRIAL),  # so that crashes are tried as well
    )
    ways = Ways([track], count)
    if race != TIME_TRIAL:
        traffic = Traffic(ways, race)
        begun = along_m / track.length_m % 1.0
        traffic.begin(np.arange(count), begun, np.arange(count, dtype=np.uint64))
        situation = replace(situation, objects=traffic.objects())
    samples = list(params_of(ways.tracks, situation, np.arange(count)))
    return [*samples, *_unusual(track, samples)]


def is_sudden(index: int, samples: int) -> bool:
    """Whether a training has no such call, or not after the one before."""
    return index >= samples + FIRST_UNUSUAL or (index % 2 == 0 and index > 0)


def _along_m(track: Track) -> Floats:
    """From the start: places in pairs, with the last waypoints and the finish. Shape (2 * n,)."""
    last_m = track.locate(np.array(track.waypoints[-1 - LAST_WAYPOINTS : -1])).distance_m + _PAST_M
    everywhere_m = np.linspace(_FIRST_M + _STEP_M, track.length_m - _STEP_M, POSITIONS)
    second_m = np.sort(np.concatenate([everywhere_m, last_m, [track.length_m + _PAST_M]]))
    return np.stack([second_m - _STEP_M, second_m], axis=1).reshape(-1)


def _choices(actions: Actions | None) -> list[tuple[float, float]]:
    actions = DEFAULT_ACTIONS if actions is None else actions
    if isinstance(actions, DiscreteActions):
        return list(actions.choices)
    (right, left), (slow, quick) = actions.steering_deg, actions.speed_mps
    steering_deg = {right, right / 2, min(max(0.0, right), left), left / 2, left}
    return [(deg, mps) for deg in sorted(steering_deg) for mps in (slow, (slow + quick) / 2, quick)]


def _unusual(track: Track, samples: Sequence[RewardParams]) -> list[RewardParams]:
    """A very long episode, a day of training, driving back, extreme actions, the wrong way.

    Few trainings meet them, so failures only there do not refuse a start. The first has the call
    before it too: what is paid for the progress since then is no more than in a short episode.
    """
    before, usual = samples[POSITIONS : POSITIONS + 2]
    slow_lap_s = track.length_m / _SLOWEST_MPS
    longest = min(MAX_EPISODE_STEPS, math.ceil(SLACK * slow_lap_s * CONTROL_HZ))
    return [
        {**before, "steps": longest - 1.0, "sim_time": (longest - 1) / CONTROL_HZ},
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

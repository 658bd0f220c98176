"""The calls that a reward function is tried with before a start, all along the laps."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drcli.base.errors import SettingsError
from drcli.base.problems import Problem, ProblemsError
from drcli.config.settings import RaceConfig
from drcli.workers.build_race import load_race, load_world
from drsim.car.car import CONTROL_HZ
from drsim.episode.params import Situation, params_of
from drsim.episode.reward import RewardParams
from drsim.race.race import TIME_TRIAL, Race
from drsim.race.traffic import Traffic
from drsim.track.track import Track
from drsim.track.worlds import load_track

POSITIONS = 40
"""Places along the lap at which the reward function is tried."""

OFFSETS = (0.0, 0.3, -0.3, 1.0)
"""Distances to the left of the centre line, in widths of the road: the last is off the track."""

_STATES = (0, POSITIONS // 4, POSITIONS // 2, 3 * POSITIONS + POSITIONS // 4, POSITIONS - 1)
"""Five samples that are tried first, in the order of `before_start.STATES`. Source: the console's
validator. The first is the first call of an episode, in which functions set up what they keep."""

_SPEED_MPS = 1.0

_FALLBACK_WORLD = "reinvent_base"
"""Where the reward function is tried when no track of the racer's own loads."""


def sample_races(
    races: Sequence[RaceConfig],
) -> tuple[list[list[RewardParams]], list[Problem]]:
    """A sequence of calls for each race of the workers, and what keeps a race from being loaded."""
    problems: list[Problem] = []
    samples: dict[tuple[str, Race], list[RewardParams]] = {}
    for own in races:
        try:
            track = load_world(own)
        except SettingsError as error:
            place = own.place("DR_WORLD_NAME")
            text, remedy = str(error), error.remedy
            problems.append(Problem("V-05", "error", *place, text, remedy, "DR_WORLD_NAME"))
            continue
        try:
            race = load_race(own, track)
        except ProblemsError as error:
            problems += error.problems
            continue
        if (own.world_name, race) not in samples:
            samples[own.world_name, race] = sample_params(track, race)
    return list(samples.values()) or [sample_params(load_track(_FALLBACK_WORLD))], problems


def sample_params(track: Track, race: Race = TIME_TRIAL) -> list[RewardParams]:
    """Reward parameters all along a lap, on the centre line, beside it and off the track."""
    count = POSITIONS * len(OFFSETS)
    fraction = np.tile(np.linspace(0.0, 1.0, POSITIONS, endpoint=False), len(OFFSETS))
    poses = track.pose_at(fraction * track.length_m)
    where = track.locate(poses[:, :2])
    aside_m = np.repeat(OFFSETS, POSITIONS) * where.track_width_m
    left = np.stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])], axis=1)
    xy = poses[:, :2] + left * aside_m[:, None]
    off = np.repeat([abs(offset) > 0.5 for offset in OFFSETS], POSITIONS)
    progress = 100.0 * fraction
    # The last step of a lap shows exactly 100.
    progress[POSITIONS - 1] = 100.0
    situation = Situation(
        xy=xy,
        heading_deg=np.degrees(poses[:, 2]),
        where=track.locate(xy),
        all_on=~off,
        none_on=off,
        progress=progress,
        steps=np.arange(2, count + 2),
        sim_time_s=np.arange(count) / CONTROL_HZ,
        steering_deg=np.zeros(count),
        speed_mps=np.full(count, _SPEED_MPS),
        backward=np.zeros(count, dtype=np.int64),
        # Where a car stands off the track it may as well have crashed.
        crashed=off & (race != TIME_TRIAL),
    )
    tracks = (track, track.reversed())
    if race != TIME_TRIAL:
        traffic = Traffic(tracks, count, race)
        seeds = np.arange(count, dtype=np.uint64)
        traffic.begin(np.arange(count), fraction, situation.backward, seeds)
        situation = replace(situation, objects=traffic.objects())
    samples = list(params_of(tracks, situation, np.arange(count)))
    rest = [params for index, params in enumerate(samples) if index not in _STATES]
    return [*(samples[index] for index in _STATES), *rest]

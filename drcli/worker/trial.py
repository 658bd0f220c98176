"""Tries a racer's inputs before anything starts: does the world load, does the reward work on it?

Run by the launcher as `python -m drcli.worker.trial FILE NAME`: FILE is a copy of the reward
function, NAME is what its author calls it. Needs no torch and no bucket, so it is quick.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from drcli.errors import SettingsError
from drcli.job import Job, LastWords
from drcli.worker.world import load_race, load_world
from drsim.car import CONTROL_HZ
from drsim.errors import RewardError
from drsim.params import Situation, params_of
from drsim.race import TIME_TRIAL, Race
from drsim.reward import RewardParams, checked_rewards, load_reward_function
from drsim.track import Track
from drsim.traffic import Traffic

POSITIONS = 40
"""Places along the lap at which the reward function is tried."""

OFFSETS = (0.0, 0.3, -0.3, 1.0)
"""Distances to the left of the centre line, in widths of the road: the last is off the track."""

TRIAL_SPEED_MPS = 1.0


def try_inputs(job: Job, path: Path, name: str) -> None:
    """Load worlds and reward function and call it along the laps, on and beside the road.

    Raises:
        SettingsError: What the racer has to correct.
    """
    settings = [job.settings.for_worker(k) for k in range(len(job.settings.overrides) + 1)]
    tracks = [load_world(own) for own in settings]
    races = [load_race(own, track) for own, track in zip(settings, tracks, strict=True)]
    try:
        function = load_reward_function(path)
        for track, race in zip(tracks, races, strict=True):
            checked_rewards(function, sample_params(track, race))
    except RewardError as error:
        raise SettingsError(
            str(error).replace(str(path), name),
            remedy=f"Correct {name}; nothing was started.",
        ) from None


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
        speed_mps=np.full(count, TRIAL_SPEED_MPS),
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
    return list(params_of(tracks, situation, np.arange(count)))


if __name__ == "__main__":
    the_job = Job.from_environment()
    LastWords.forget(the_job.folder, "trial")
    try:
        try_inputs(the_job, Path(sys.argv[1]), sys.argv[2])
    except SettingsError as failure:
        LastWords.of(failure).leave(the_job.folder, "trial")
        raise SystemExit(failure.code) from None

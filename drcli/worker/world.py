"""The track and the reward function of a run, loaded for a worker. Needs no torch."""

import math
from pathlib import Path

from drcli.config import Settings
from drcli.errors import SettingsError
from drcli.model_metadata import ModelMetadata
from drcli.store import keys
from drcli.store.bucket import Bucket
from drsim.actions import Actions, ContinuousActions, DiscreteActions
from drsim.car import CONTROL_HZ, MIN_SPEED_MPS
from drsim.errors import RewardError, TrackError
from drsim.reward import RewardFunction, load_reward_function
from drsim.track import Track
from drsim.worlds import load_track

SLACK = 2.5
"""How many times the slowest lap's duration an episode may last: a car may wind its way."""

MAX_EPISODE_STEPS = 10_000
"""Longest episode. The reference has no limit; a car that never ends its lap teaches nothing."""


def load_world(settings: Settings, directory: Path) -> Track:
    """The track that DR_WORLD_NAME names."""
    try:
        return load_track(settings.world_name, tracks_folder(settings, directory))
    except TrackError as error:
        where = settings.source("DR_WORLD_NAME")
        raise SettingsError(
            f"DR_WORLD_NAME={settings.world_name} ({where}): {error}",
            remedy="Correct the name, or put the route file into the folder DR_TRACKS_DIR.",
        ) from None


def tracks_folder(settings: Settings, directory: Path) -> Path | None:
    """The folder with the racer's own route files, if there is one."""
    if not settings.tracks_dir:
        return None
    return directory / settings.tracks_dir


def load_reward(bucket: Bucket, prefix: str, folder: Path) -> RewardFunction:
    """The model's own copy of the racer's reward function."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / keys.REWARD_FUNCTION_FILE
    path.write_bytes(bucket.get(keys.reward_function(prefix)))
    try:
        return load_reward_function(path)
    except RewardError as error:
        raise reward_failure(error) from None


def reward_failure(error: RewardError) -> SettingsError:
    """A reward function's failure, explained to its author, who never saw our copy of the file."""
    text = str(error)
    if error.file is not None:
        text = text.replace(str(error.file), error.file.name)
    return SettingsError(
        f"Reward function error: {text}",
        remedy="Correct reward_function.py, then go on with `dr-start-training --resume`, "
        "or start over with `-w`.",
    )


def actions_of(metadata: ModelMetadata) -> Actions:
    """The action space of model_metadata.json, as the simulation understands it."""
    space = metadata.action_space
    if space.low is None or space.high is None:
        return DiscreteActions(space.values)
    steering_deg, speed_mps = zip(space.low, space.high, strict=True)
    return ContinuousActions(steering_deg, speed_mps)


def longest_episode(track: Track, actions: Actions) -> int:
    """Steps after which an episode is cut off: far more than the slowest lap takes."""
    if isinstance(actions, ContinuousActions):
        slowest_mps = actions.speed_mps[0]
    else:
        slowest_mps = min(speed_mps for _, speed_mps in actions.choices)
    lap_s = track.length_m / max(slowest_mps, MIN_SPEED_MPS)
    return min(MAX_EPISODE_STEPS, math.ceil(SLACK * lap_s * CONTROL_HZ))

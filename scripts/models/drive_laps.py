"""Drives laps with a ready-made model in this process, as `dr-evaluate` does in its worker."""

from collections.abc import Mapping

import torch

from drcli.config.loading import load_settings
from drcli.config.presets import settings_file
from drcli.config.settings import Settings
from drcli.convert.build_network import build_policy, load_weights
from drcli.drive.build_race import actions_of, build_simulation, load_world
from drcli.drive.driving import Driven, Driver, Plan, Racer
from drcli.drive.evaluator import laps_of
from drcli.model import keys
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.transfer.ready_made import DrivenLaps, ReadyMadeModel
from drsim.car.car import CONTROL_HZ
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.track.worlds import directed

SEED = 0
"""Of `dr-evaluate` without --seed or DR_TRAIN_SEED."""


def drive_laps(
    model: ReadyMadeModel, world: str, *, reverse: bool, disturbed: bool, laps: int = 3
) -> DrivenLaps:
    """Laps in one race, by the shipped evaluation settings.

    Args:
        model: What drives.
        world: The track.
        reverse: Whether to drive in the opposite direction.
        disturbed: Whether the disturbances of the model's training apply.
        laps: How many.
    """
    metadata = ModelMetadata.from_bytes(model.files[keys.MODEL_METADATA_FILE])
    parameters = Hyperparameters.from_bytes(model.files[keys.HYPERPARAMETERS_FILE])
    policy = build_policy(metadata, parameters)
    load_weights(policy, model.tensors, model.card.checkpoint)
    torch.set_num_threads(1)
    own = {**model.settings, "DR_SIM_EXTRAS_IN": "both"} if disturbed else {}
    settings = _shipped({**own, "DR_WORLD_NAME": world, "DR_EXPERIMENT_NAME": ""})
    race = settings.race
    simulation = build_simulation(
        race,
        "evaluation",
        metadata,
        directed(load_world(race), reverse=reverse),
        num_cars=1,
        reward=centre_line_reward,
        rules=_rules(settings, laps),
        num_threads=1,
        seed=SEED,
    )
    driven: list[Driven] = []
    try:
        racer = Racer(policy, actions_of(metadata))
        Driver(simulation, [racer], SEED).drive([Plan(0, "evaluation", 0.0)], driven.append)
    finally:
        simulation.close()
    episodes = laps_of(driven[0])
    ends = [episode.rows[-1] for episode in episodes]
    return DrivenLaps(
        world,
        reverse,
        disturbed,
        ["Lap complete" if row.progress >= 100.0 else row.status for row in ends],
        [round(float(episode.duration_s), 3) for episode in episodes],
        sum(row.status == "off_track" for episode in episodes for row in episode.rows),
    )


def _shipped(flags: Mapping[str, str]) -> Settings:
    """The shipped settings with some others."""
    contents = {name: settings_file(name).read_bytes() for name in ("run.env", "system.env")}
    folder = settings_file("run.env").parent
    return load_settings(folder, environ={}, flags=flags, contents=contents)


def _rules(s: Settings, laps: int) -> EpisodeRules:
    return EpisodeRules.evaluation(
        laps=laps,
        max_resets=s.eval_max_resets,
        off_track_penalty_s=s.eval_off_track_penalty,
        collision_penalty_s=s.eval_collision_penalty,
        max_steps=int(s.eval_max_lap_seconds * CONTROL_HZ) * laps,
    )

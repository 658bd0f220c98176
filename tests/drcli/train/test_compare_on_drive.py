"""Graphs are compared on what cars see while they drive."""

import json

import pytest
import torch
from safetensors.torch import save

from drcli.base.errors import SettingsError
from drcli.checks.compare_on_drive import compare_on_drive, record_drive
from drcli.config.loading import load_settings
from drcli.convert.build_network import build_policy, policy_spec, weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.learn.actor_critic import ActorCritic
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from small_model import METADATA


def design(**changes) -> Design:
    return Design(
        ModelMetadata.from_bytes(json.dumps({**METADATA, **changes}).encode()),
        Hyperparameters.from_bytes(b"{}", "hyperparameters.json"),
        "model_metadata.json",
        "hyperparameters.json",
    )


def made(asked: Design, seed: int = 1) -> tuple[ActorCritic, bytes, bytes]:
    """A network that prefers some actions, its weights and its graph."""
    torch.manual_seed(seed)
    model = build_policy(asked.metadata, asked.parameters)
    assert isinstance(model, ActorCritic)
    with torch.no_grad():
        model.policy_head.weight.mul_(300.0)
    weights = save({name: tensor.contiguous() for name, tensor in model.state_dict().items()})
    spec = policy_spec(asked.metadata, asked.parameters)
    return model, weights, encode_policy(weights_of(model), spec, asked.metadata.sensor)


def test_a_graph_does_what_its_weights_do_with_every_sensor(working_folder):
    race = load_settings(working_folder).race
    asked = design(sensor=["FRONT_FACING_CAMERA", "SECTOR_LIDAR"])
    _, weights, graph = made(asked)

    found = compare_on_drive(race, asked, weights, "5_Step-500.ckpt", graph, frames=30)

    assert found.frames == found.same_actions == 30
    assert found.greatest_difference < 1e-5


def test_another_graph_is_found_out(working_folder):
    race = load_settings(working_folder).race
    asked = design()
    (_, weights, _), (_, _, other) = made(asked), made(asked, seed=2)

    found = compare_on_drive(race, asked, weights, "5_Step-500.ckpt", other, frames=8)

    assert not found.is_equal


def test_weights_that_do_not_fit_are_refused(working_folder):
    race = load_settings(working_folder).race
    _, weights, graph = made(design())
    wide = design(neural_network="DEEP_CONVOLUTIONAL_NETWORK_SHALLOW")

    with pytest.raises(SettingsError, match=r"5_Step-500\.ckpt do not fit"):
        compare_on_drive(race, wide, weights, "5_Step-500.ckpt", graph, frames=8)


def test_frames_of_a_drive_differ_from_each_other(working_folder):
    asked = design()

    seen = record_drive(load_settings(working_folder).race, asked.metadata, made(asked)[0], 24)

    assert seen.frames.shape == (24, 1, 120, 160)
    assert len({frame.numpy().tobytes() for frame in seen.frames}) > 12

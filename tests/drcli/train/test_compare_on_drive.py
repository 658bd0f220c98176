"""Graphs are compared on what cars see while they drive."""

import json
from dataclasses import replace

import pytest
import torch
from safetensors.torch import save

from drcli.base.errors import SettingsError
from drcli.checks.compare_on_drive import compare_on_drive, overlay_agreement, record_drive
from drcli.config.loading import load_settings
from drcli.convert.build_network import build_policy, policy_spec, weights_of
from drcli.convert.car_archive import CarCheck, car_archive, check_car_archive
from drcli.convert.frozen_graph import encode_policy
from drcli.learn.actor_critic import ActorCritic
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drsim.track.worlds import load_track
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


def archive_of(asked: Design, *, blind: bool = False) -> CarCheck:
    model, _, _ = made(asked)
    if blind:
        torch.nn.init.zeros_(model.policy_head.weight)
    spec = policy_spec(asked.metadata, asked.parameters)
    graph = encode_policy(weights_of(model), spec, asked.metadata.sensor)
    return check_car_archive(car_archive(graph, asked.metadata), "model.tar.gz")


RANGES = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 2}}


@pytest.mark.parametrize(
    "kind",
    [
        {},
        {"action_space_type": "continuous", "action_space": RANGES},
        {"sensor": ["STEREO_CAMERAS", "LIDAR"]},
    ],
)
def test_the_overlay_changes_what_a_network_does_that_sees_it(kind):
    check = archive_of(design(**kind))
    found = overlay_agreement(load_track("reinvent_base"), check)

    assert found is not None
    assert (found.world, found.frames) == ("reinvent_base", 20)
    assert found.same_actions < 20
    assert found.is_low == (found.same_actions < 18)
    blind = overlay_agreement(load_track("reinvent_base"), archive_of(design(**kind), blind=True))
    assert blind is not None
    assert (blind.same_actions, blind.is_low) == (20, False)


def test_a_graph_that_was_found_wrong_is_not_run():
    check = archive_of(design())
    assert check.graph

    for other in (replace(check, graph=b""), replace(check, sensors=("LIDAR",))):
        assert overlay_agreement(load_track("reinvent_base"), other) is None

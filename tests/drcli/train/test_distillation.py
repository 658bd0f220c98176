"""A network of the reference's learns what a model with another network does."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import save

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.convert.build_network import build_policy, load_weights
from drcli.learn.policy import Observation
from drcli.model import keys
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.records.scores import SecondEvaluation
from drcli.train import distillation
from drcli.train.distillation import Teaching, distil, each_way, is_needed, student_design
from drcli.train.training_simulation import HeldOutTracks
from drcli.transfer.ready_made import read_ready_made
from made_up_rollout import made_up_rollout
from small_policies import metadata_json

KINDS = {
    "list": ("discrete", {}),
    "ranges": ("continuous", {}),
    "sac": ("sac", {"exploration_type": "additive_noise"}),
    "stack": ("discrete", {"stack_size": 3}),
    "taught": ("continuous", {"training_method": "teacher"}),
    "state": ("discrete", {"critic": "state"}),
}


def design(head="discrete", **parameters):
    files = {
        keys.MODEL_METADATA_FILE: metadata_json(head),
        keys.HYPERPARAMETERS_FILE: json.dumps({"lr": 0.0005, **parameters}).encode(),
    }
    metadata, values = files.values()
    return Design(
        ModelMetadata.from_bytes(metadata), Hyperparameters.from_bytes(values), "m", "h", files
    )


def weights_of(asked, seed=1):
    torch.manual_seed(seed)
    state = build_policy(asked.metadata, asked.parameters).state_dict()
    return save({name: tensor.contiguous() for name, tensor in state.items()})


@pytest.mark.parametrize("kind", KINDS)
def test_the_new_network_has_the_actions_and_sensors_of_the_model(kind):
    asked = design(KINDS[kind][0], **KINDS[kind][1])

    made = student_design(asked)

    assert is_needed(asked)
    assert not is_needed(made)
    assert made.metadata.neural_network == "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
    assert made.metadata.action_space == asked.metadata.action_space
    assert made.metadata.sensor == asked.metadata.sensor
    assert made.parameters.lr == asked.parameters.lr
    assert made.conflicts() == []


@pytest.mark.parametrize("kind", KINDS)
def test_labels_are_what_the_model_would_do_in_each_step(kind):
    asked = design(KINDS[kind][0], **KINDS[kind][1])
    weights = weights_of(asked)
    driven = made_up_rollout(8, 5)  # four episodes of two steps
    teaching = Teaching(asked, weights, "1_Step-1.ckpt")

    labels = teaching.labels(driven)

    frames = driven.frames[driven.stacked_rows(teaching.spec.stack)]
    seen = Observation.of_arrays(
        frames.reshape(8, -1, 120, 160), driven.scans, np.empty((8, 0), np.float32)
    )
    noise = torch.zeros(8, teaching.spec.noise_dims)
    actions, _, _ = teaching.act(seen, noise, torch.ones(8, dtype=torch.bool), None)
    if teaching.spec.continuous:
        np.testing.assert_allclose(labels, actions.detach().numpy(), atol=1e-6)
    else:
        np.testing.assert_array_equal(labels.argmax(axis=1), actions.numpy())
        np.testing.assert_allclose(labels.sum(axis=1), 1.0, rtol=1e-5)


@pytest.fixture
def short(working_folder, monkeypatch):
    """Distils a model that knows nothing, in one iteration with two laps, with lines of run.env."""
    monkeypatch.setattr(distillation, "LAPS", 2)
    monkeypatch.setattr(distillation, "MIXED_ITERATIONS", 1)
    monkeypatch.setattr(distillation, "EPISODES", {"distillation": 2})
    monkeypatch.setattr(distillation.PhaseJudge, "most_steps", lambda *_: 1)

    def short(asked, *lines, seed=0):
        (working_folder / "run.env").write_text("\n".join(lines))
        settings = load_settings(working_folder)
        said = []
        made = distil(
            settings.races,
            settings.run.train,
            asked,
            weights_of(asked),
            "1_Step-1.ckpt",
            seed=seed,
            say=said.append,
        )
        return made, said

    return short


def evaluations(monkeypatch, *clean):
    """Let evaluations have so many clean laps of two, in turn."""
    left = list(clean)

    def evaluate(*_, **__):
        count = left.pop(0)
        return SecondEvaluation([100.0] * 2, [0.0] * 2, [8.0] * count, "oval")

    monkeypatch.setattr(HeldOutTracks, "evaluate", evaluate)
    return left


def test_the_weights_are_of_the_new_network_and_equal_for_equal_seeds(short, monkeypatch):
    monkeypatch.setattr(distillation, "LEAST_CLEAN", 0.0)
    asked = design("continuous")

    made, said = short(asked)
    again, _ = short(asked)
    other, _ = short(asked, seed=1)

    model = build_policy(made.design.metadata, made.design.parameters)
    load_weights(model, made.weights, "made")
    assert made.weights == again.weights != other.weights
    assert made.steps > 0
    assert made.laps.driven == made.original.driven == 2
    assert said[0].startswith("1_Step-1.ckpt drives 0 of 2 laps")
    assert "0 of 2 laps" in str(made)


def test_a_model_that_does_not_lap_is_refused_before_anything_is_learned(short):
    with pytest.raises(SettingsError, match=r"completes 0 of 2 laps.*2 are needed"):
        short(design())


def test_a_network_that_does_not_lap_in_the_end_is_refused(short, monkeypatch):
    left = evaluations(monkeypatch, 2, 1, 1)  # the model's, an iteration's, and the last

    with pytest.raises(SettingsError, match=r"completes 1 of 2 laps, 1_Step-1\.ckpt 2"):
        short(design())

    assert not left


def test_it_ends_when_the_network_laps_as_the_model_does(short, monkeypatch):
    monkeypatch.setattr(distillation.PhaseJudge, "most_steps", lambda *_: 1_000_000)
    left = evaluations(monkeypatch, 2, 1, 2, 2)

    made, said = short(design())

    assert not left
    assert made.laps.clean == 2
    assert len(said) == 3


def test_it_drives_every_track_of_the_training_in_both_directions(short, monkeypatch):
    left = evaluations(monkeypatch, 2, 2, 2)
    built, tracks = distillation.build_simulation, []

    def build_simulation(race, job, metadata, track, **named):
        tracks.extend(track)
        return built(race, job, metadata, track, **named)

    monkeypatch.setattr(distillation, "build_simulation", build_simulation)

    short(
        design(),
        "DR_WORLD_NAME=bean",
        "DR_TRAIN_WORLDS=willow",
        "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION=True",
    )

    assert not left
    assert [track.name for track in tracks] == ["bean", "willow"] * 2
    forwards, backwards = tracks[0], tracks[2]
    assert forwards.length_m == pytest.approx(backwards.length_m)
    yaws = [track.pose_at(np.zeros(1))[0, 2] for track in (forwards, backwards)]
    assert abs(np.cos(yaws[0]) + np.cos(yaws[1])) < 0.1


def test_tracks_of_other_workers_are_driven_too_each_way_once(working_folder):
    (working_folder / "run.env").write_text(
        "DR_WORLD_NAME=bean\nDR_TRAIN_WORLDS=paddle\nDR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=4\n"
    )
    for number, line in enumerate(
        (
            "DR_WORLD_NAME=willow",
            "DR_TRAIN_REVERSE_DIRECTION=True",
            "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION=True",
        ),
        start=2,
    ):
        (working_folder / f"worker-{number}.env").write_text(f"{line}\n")

    races = each_way(load_settings(working_folder).races)

    ways = [(race.world_name, race.train_reverse_direction) for race in races]
    assert ways[0] == ("bean", False)  # its car and obstacles are taken
    assert len(ways) == len(set(ways)) == 5
    assert set(ways) == {
        ("bean", False),
        ("bean", True),
        ("paddle", False),
        ("paddle", True),
        ("willow", False),
    }


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", ["fast", "safe"])
def test_a_ready_made_model_is_followed_on_its_tracks(working_folder, name):
    model = read_ready_made(name)
    lines = [f"{key}={value}" for key, value in model.settings.items()]
    (working_folder / "run.env").write_text("\n".join(lines))
    settings = load_settings(working_folder)
    metadata, parameters = (
        model.files[each] for each in (keys.MODEL_METADATA_FILE, keys.HYPERPARAMETERS_FILE)
    )
    asked = Design(
        ModelMetadata.from_bytes(metadata),
        Hyperparameters.from_bytes(parameters),
        "m",
        "h",
        {keys.MODEL_METADATA_FILE: metadata, keys.HYPERPARAMETERS_FILE: parameters},
    )

    made = distil(
        settings.races,
        settings.run.train,
        asked,
        model.tensors,
        name,
        seed=1,
        say=lambda sentence: None,
    )

    assert made.laps.clean >= 36
    assert made.laps.median_s <= 1.05 * made.original.median_s

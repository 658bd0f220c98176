"""Parameter files become networks and learners of the right shape and with the right knobs."""

import json
import subprocess
import sys
from dataclasses import asdict, fields
from pathlib import Path

import pytest
import torch
from safetensors.torch import save

from drcli.convert.build_network import STATE_DIMS, policy_spec
from drcli.drive.build_race import sensors_of_model
from drcli.learn.algorithms import PPOConfig, SACConfig, algorithm_config
from drcli.learn.compute import Compute
from drcli.learn.ppo import PPO
from drcli.learn.sac import SAC
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.train.checkpoint_publisher import restore_optimizer
from drcli.train.learner_group import build_learner
from drsim.episode.teacher_features import PRIVILEGED_DIMS

RANGES = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 2}}
SAC_PRESET = Path(__file__).resolve().parents[3] / "defaults" / "presets" / "sac"
CPU = Compute(torch.device("cpu"), bf16=False, reason="test")


def metadata(**changes) -> ModelMetadata:
    values = {"action_space": [{"steering_angle": 0, "speed": 1}], "version": "5", **changes}
    return ModelMetadata.from_bytes(json.dumps(values).encode())


@pytest.mark.parametrize("camera", ["FRONT_FACING_CAMERA", "LEFT_CAMERA", "STEREO_CAMERAS"])
@pytest.mark.parametrize("lidar", [None, "LIDAR", "SECTOR_LIDAR", "DISCRETIZED_SECTOR_LIDAR"])
def test_the_network_expects_what_the_car_perceives(camera, lidar):
    names = [camera] if lidar is None else [lidar, camera]
    read = metadata(sensor=names, lidar_config={"num_sectors": 4, "num_values_per_sector": 3})

    spec = policy_spec(read, Hyperparameters())

    sensors = sensors_of_model(read)
    assert (spec.eyes, spec.scan_dims) == (sensors.eyes, sensors.num_values)


def test_a_critic_that_sees_the_state_expects_what_the_simulation_tells():
    assert STATE_DIMS == PRIVILEGED_DIMS
    assert policy_spec(metadata(), Hyperparameters(critic="state")).state_dims == STATE_DIMS
    assert policy_spec(metadata(), Hyperparameters()).state_dims == 0


def test_the_template_of_sac_is_taken_without_a_warning_and_says_what_it_relies_on():  # 000-15
    parameters = Hyperparameters.from_bytes((SAC_PRESET / "hyperparameters.json").read_bytes())
    read = ModelMetadata.from_bytes((SAC_PRESET / "model_metadata.json").read_bytes())

    assert (parameters.problems, read.problems) == ((), ())
    assert parameters.conflict(read.algorithm, continuous=read.action_space.continuous) is None
    assert policy_spec(read, parameters).state_dims == STATE_DIMS
    config = algorithm_config(SACConfig, parameters)
    assert config.sac_auto_alpha
    # Written in the file, although these are what is used without them: a racer can see and change
    # them there.
    for name in ("sac_n_step", "sac_tau", "sac_replay_steps", "sac_learning_starts"):
        assert getattr(parameters, name) == getattr(SACConfig(), name)


def test_the_algorithm_is_the_one_of_the_metadata():
    sac = metadata(training_algorithm="sac", action_space=RANGES, action_space_type="continuous")
    small = Hyperparameters(sac_replay_steps=1_000, stack_size=2)

    assert isinstance(build_learner(metadata(), small, CPU), PPO)
    learner = build_learner(sac, small, CPU)
    assert isinstance(learner, SAC)
    assert learner.memory_steps == 1_000
    assert learner.model.spec.channels == 2


def test_an_optimizer_state_of_another_network_is_left_with_a_sentence(logged):
    learner = build_learner(metadata(), Hyperparameters(), CPU)

    restore_optimizer(learner, save({"0.exp_avg": torch.zeros(1)}))

    assert learner.optimizer.tensors() == {}
    [line] = logged().splitlines()
    assert "WARNING The optimizer starts over" in line
    assert "does not fit: 0.exp_avg is of shape (1,)" in line


@pytest.mark.parametrize(
    "setting",
    [
        {"batch_size": 32},
        {"num_epochs": 7},
        {"lr": 0.0001},
        {"discount_factor": 0.9},
        {"beta_entropy": 0.02},
        {"clip_range": 0.1},
        {"gae_lambda": 0.9},
        {"clip_value": 0.3},
        {"clip_advantage": 3.0},
        {"target_kl": 0.02},
        {"max_grad_norm": 0.5},
        {"lr_schedule": "linear"},
        {"entropy_schedule": "linear"},
        {"schedule_steps": 9},
        {"bootstrap_cut": True},
    ],
)
def test_every_hyperparameter_of_ppo_reaches_the_learner(setting):
    config = algorithm_config(PPOConfig, Hyperparameters(**setting))

    assert setting.items() <= asdict(config).items()


@pytest.mark.parametrize(
    "setting",
    [
        {"batch_size": 32},
        {"lr": 0.0001},
        {"discount_factor": 0.9},
        {"sac_alpha": 0.1},
        {"sac_auto_alpha": True},
        {"sac_tau": 0.5},
        {"sac_n_step": 3},
        {"sac_updates_per_step": 2.0},
        {"sac_replay_steps": 5_000},
        {"sac_learning_starts": 7},
    ],
)
def test_every_hyperparameter_of_sac_reaches_the_learner(setting):
    config = algorithm_config(SACConfig, Hyperparameters(**setting))

    assert setting.items() <= asdict(config).items()


@pytest.mark.parametrize("kind", [PPOConfig, SACConfig])
@pytest.mark.parametrize(("loss_type", "huber"), [("huber", True), ("mean squared error", False)])
def test_the_loss_type_reaches_the_learner(kind, loss_type, huber):
    assert algorithm_config(kind, Hyperparameters(loss_type=loss_type)).huber is huber


def test_no_field_of_an_algorithm_but_adams_epsilon_is_without_a_hyperparameter():
    names = {field.name for kind in (PPOConfig, SACConfig) for field in fields(kind)}

    assert {name for name in names if not hasattr(Hyperparameters(), name)} == {
        "adam_eps",
        "smoothness",  # of a teacher
    }


def test_the_trainer_does_not_load_the_simulator():
    code = "import sys, drcli.train.trainer; sys.exit('drsim' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

"""Several learner processes learn what one learns, and the end of one of them is said."""

import copy
import json

import numpy as np
import pytest
import torch

from drcli.base.errors import SettingsError
from drcli.learn.compute import Compute
from drcli.learn.data_parallel import LearnerLostError
from drcli.learn.update_result import NonFiniteLossError
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.train import learner_group as gradient_memory
from drcli.train.learner_group import Build, LearnerGroup, build_learner, learner_group
from made_up_rollout import made_up_rollout

CPU = Compute(torch.device("cpu"), bf16=False, reason="test")
STEPS = 24


@pytest.fixture(scope="module")
def group():
    with learner_group(2) as made:
        yield made


@pytest.mark.parametrize("through", ["memory", "messages"])
def test_the_gradients_of_two_processes_equal_those_of_one(group, through, monkeypatch, tmp_path):
    if through == "messages":
        monkeypatch.setattr(gradient_memory, "FOLDER", tmp_path / "missing")
    monkeypatch.setattr(group, "_parameters", 0)
    parameters = Hyperparameters(batch_size=STEPS, num_epochs=1)
    alone = build_learner(_metadata(), parameters, CPU)
    together = _learner_of(group, parameters)
    together.model.load_state_dict(alone.model.state_dict())

    one = alone.update(_rollout(), 5)
    group.begin_update(together, _rollout(), 5, 0)
    two = together.update(_rollout(), 5)

    assert (group.gradients.slots is None) == (through == "messages")
    for p, q in zip(alone.model.parameters(), together.model.parameters(), strict=True):
        torch.testing.assert_close(q.grad, p.grad, rtol=1e-5, atol=1e-6)
    assert two[0].metrics() == pytest.approx(one[0].metrics(), rel=1e-4, abs=1e-5)


def test_updates_follow_each_other_with_the_state_of_the_optimizer(group):
    parameters = Hyperparameters(batch_size=9, num_epochs=2)
    alone = build_learner(_metadata(), parameters, CPU)
    together = _learner_of(group, parameters)
    together.model.load_state_dict(alone.model.state_dict())

    for seed in (1, 2):
        alone.update(_rollout(seed), seed)
        group.begin_update(together, _rollout(seed), seed, 0)
        together.update(_rollout(seed), seed)

    for name, tensor in alone.model.state_dict().items():
        torch.testing.assert_close(
            together.model.state_dict()[name], tensor, rtol=1e-2, atol=2e-4, msg=name
        )


def test_soft_actor_critic_divides_its_replay_buffer(group):
    parameters = Hyperparameters(
        batch_size=8, sac_learning_starts=1, sac_replay_steps=1000, sac_updates_per_step=0.2
    )
    learner = _learner_of(group, parameters, algorithm="sac")
    before = copy.deepcopy(learner.model.state_dict())

    group.remember(_rollout(3, continuous=True))
    learner.remember(_rollout(3, continuous=True))
    rollout = _rollout(4, continuous=True)
    group.begin_update(learner, rollout, 4, 0)
    stats = learner.update(rollout, 4)

    assert learner.replay.capacity == 500
    assert learner.replay.steps == STEPS, "half of what both rollouts have"
    assert np.isfinite(stats[-1].qf_loss)
    assert any(not torch.equal(before[n], t) for n, t in learner.model.state_dict().items())


def test_after_a_loss_that_is_not_finite_the_processes_go_on(group):
    parameters = Hyperparameters(batch_size=STEPS, num_epochs=1)
    learner = _learner_of(group, parameters)
    with torch.no_grad():
        learner.model.policy_head.weight[0, 0] = torch.inf

    group.begin_update(learner, _rollout(), 1, 0)
    with pytest.raises(NonFiniteLossError):
        learner.update(_rollout(), 1)
    learner = _learner_of(group, parameters)
    group.begin_update(learner, _rollout(), 1, 0)

    assert learner.update(_rollout(), 1)


def test_memory_that_is_not_there_is_not_promised(tmp_path, monkeypatch):
    monkeypatch.setattr(gradient_memory, "FOLDER", tmp_path)

    assert gradient_memory.create(2, 1 << 50) is None
    assert not list(tmp_path.iterdir())


def test_all_processes_see_the_same_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(gradient_memory, "FOLDER", tmp_path)
    path, slots = gradient_memory.create(3, 5)

    slots[1, 2, 4] = 7.0

    assert gradient_memory.attach(path, 3, 5)[1, 2, 4] == 7.0
    assert slots.shape == (2, 3, 5)


def test_fewer_gpus_than_processes_are_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)

    with pytest.raises(SettingsError, match=r"DR_TRAIN_LEARNERS.* is 2, but the trainer has 1 GPU"):
        LearnerGroup(2)


def test_the_end_of_another_process_is_noticed_at_once(group):
    """The last test: the group is broken afterwards."""
    parameters = Hyperparameters(batch_size=STEPS, num_epochs=1)
    learner = _learner_of(group, parameters)
    group._processes[0].kill()
    group._processes[0].wait()

    with pytest.raises(LearnerLostError):
        group.begin_update(learner, _rollout(), 1, 0)


def _learner_of(group, parameters, algorithm="clipped_ppo"):
    build = Build(_metadata(algorithm), parameters, CPU)
    group.tell(build)
    torch.manual_seed(0)
    return build_learner(build.metadata, parameters, CPU, group.gradients)


def _metadata(algorithm="clipped_ppo"):
    values = {
        "action_space": [{"steering_angle": 0, "speed": 1}, {"steering_angle": 20, "speed": 1}],
        "version": "5",
        "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
    }
    if algorithm == "sac":
        space = {
            "steering_angle": {"low": -30, "high": 30},
            "speed": {"low": 1, "high": 2},
        }
        values |= {
            "action_space": space,
            "action_space_type": "continuous",
            "training_algorithm": "sac",
        }
    return ModelMetadata.from_bytes(json.dumps(values).encode())


def _rollout(seed=0, *, continuous=False):
    return made_up_rollout(STEPS, 2, seed, continuous=continuous)

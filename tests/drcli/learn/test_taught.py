"""A teacher learns from the state, its student from the teacher, then from what it drives."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from drcli.learn.actor_critic import ActorCritic, Teacher
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute
from drcli.learn.policy import Observation, PolicySpec, decide
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.taught import SMALL_LOG_STD, TaughtLearner

CPU = Compute(torch.device("cpu"), bf16=False, reason="test")
STEPS, STATE = 48, 5
OF_TEACHER = ("teacher.", "value_head.", "returns.")


def learner(*, continuous: bool = True) -> TaughtLearner:
    torch.manual_seed(3)
    spec = PolicySpec(2, continuous, "COMPACT_CONVOLUTIONAL_NETWORK", state_dims=STATE, taught=True)
    return TaughtLearner(ActorCritic(spec), PPOConfig(batch_size=16, num_epochs=2), CPU)


def rollout(model: ActorCritic, seed: int = 0, *, drawn: bool = True) -> Rollout:
    """One step each of some episodes, driven by the teacher; good actions are those upwards."""
    random = np.random.default_rng(seed)
    size = (120, 160) if drawn else (0, 0)
    frames = random.integers(0, 255, (STEPS, 1, *size), dtype=np.uint8)
    states = random.normal(size=(STEPS, STATE)).astype(np.float32)
    scans = np.empty((STEPS, 0), np.float32)
    noise = random.random((STEPS, 2)).astype(np.float32)
    if model.spec.continuous:
        noise = random.normal(size=(STEPS, 2)).astype(np.float32)
    seen = Observation.of_arrays(frames, scans, states)
    driven = decide(Teacher(model).eval(), seen, noise, np.zeros(STEPS, np.bool_))
    good = driven.actions[:, 0] > 0 if model.spec.continuous else driven.actions == 1
    return Rollout(
        frames,
        driven.actions,
        driven.log_probs,
        driven.values,
        np.where(good, 1.0, -1.0),
        np.ones(STEPS, np.int64),
        np.zeros(STEPS),
        np.zeros(STEPS, np.bool_),
        scans,
        states,
    )


def preference(model: ActorCritic, states: np.ndarray) -> float:
    policy = Teacher(model).policy(torch.from_numpy(states)).detach()
    return float((policy[:, 0] if model.spec.continuous else policy.softmax(-1)[:, 1]).mean())


def changed(before: dict[str, torch.Tensor], model: ActorCritic) -> set[str]:
    return {name for name, new in model.state_dict().items() if not torch.equal(before[name], new)}


@pytest.mark.parametrize("continuous", [True, False])
def test_a_teacher_learns_without_a_single_picture(continuous):
    taught = learner(continuous=continuous)
    driven = rollout(taught.model, drawn=False)
    before = preference(taught.model, driven.states)
    weights = copy.deepcopy(taught.model.state_dict())

    for seed in range(3):
        taught.update(driven, seed)

    assert preference(taught.model, driven.states) > before
    assert all(name.startswith(OF_TEACHER) for name in changed(weights, taught.model))


@pytest.mark.parametrize("continuous", [True, False])
def test_a_student_learns_what_its_teacher_would_do(continuous):
    taught = learner(continuous=continuous)
    with torch.no_grad():
        taught.model.teacher.layers[-1].weight.mul_(100.0)  # it has an opinion
    taught.begin("distillation")
    weights = copy.deepcopy(taught.model.state_dict())

    losses = [taught.update(rollout(taught.model), seed)[-1].imitation_loss for seed in range(12)]

    assert losses[-1] < 0.7 * losses[0] if continuous else losses[-1] < losses[0]
    new = changed(weights, taught.model)
    assert new
    assert all(name.startswith(("body.", "policy_head.")) for name in new)


def test_teacher_and_student_drive_with_little_noise_in_distillation():
    taught = learner()

    taught.begin("distillation")

    assert taught.model.log_std.tolist() == pytest.approx([SMALL_LOG_STD] * 2)
    assert taught.model.teacher.log_std.tolist() == pytest.approx([SMALL_LOG_STD] * 2)


def test_a_student_that_drives_alone_leaves_its_teacher_as_it_is():
    taught = learner()
    taught.begin("ppo")
    taught.critic_warmup = 0
    weights = copy.deepcopy(taught.model.state_dict())

    taught.update(rollout(taught.model), 1)

    new = changed(weights, taught.model)
    assert {"policy_head.weight", "value_head.0.weight"} <= new
    assert not any(name.startswith("teacher.") for name in new)


def test_a_learner_that_was_ended_goes_on_with_what_was_remembered_for_it():
    taught = learner()
    taught.begin("distillation")
    first, second = (rollout(taught.model, seed) for seed in (1, 2))
    taught.update(first, 1)
    state = {name: tensor.contiguous() for name, tensor in taught.model.state_dict().items()}
    weights = save_tensors(state)
    moments = save_tensors(taught.optimizer.tensors())

    restored = learner()
    restored.begin("distillation")
    restored.model.load_state_dict(load_tensors(weights))
    restored.optimizer.restore(load_tensors(moments))
    restored.remember(first)
    for each in (taught, restored):
        each.update(second, 2, steps_before=first.steps)

    assert not changed(taught.model.state_dict(), restored.model)


def test_what_was_driven_without_pictures_is_not_remembered():
    taught = learner()
    taught.begin("distillation")

    taught.remember(rollout(taught.model, drawn=False))
    stats = taught.update(replace(rollout(taught.model)), 1)

    assert all(np.isfinite(each.imitation_loss) for each in stats)

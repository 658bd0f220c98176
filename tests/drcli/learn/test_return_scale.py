"""Rewards of any size train alike."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load, save

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.advantages import UNITS, ReturnScale
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute
from drcli.learn.policy import Observation, PolicySpec, decide
from drcli.learn.ppo import PPO
from drcli.learn.rollout_buffer import Rollout

CPU = Compute(torch.device("cpu"), bf16=False, reason="test")
CONFIG = PPOConfig(batch_size=8, num_epochs=1, lr=1e-3, max_grad_norm=0.5, bootstrap_cut=True)
SPEC = PolicySpec(3, network="COMPACT_CONVOLUTIONAL_NETWORK")
STEPS = 16


@pytest.mark.parametrize("factor", [1e-3, 7.0, 1e4])
@pytest.mark.parametrize("spec", [SPEC, replace(SPEC, continuous=True, state_dims=4)], ids=str)
def test_rewards_times_a_constant_train_to_the_same_byte(spec, factor):
    one, other = trained(spec, rewards()), trained(spec, [factor * row for row in rewards()])

    for name, tensor in one.state_dict().items():
        if not name.startswith("returns."):
            assert torch.equal(tensor, other.state_dict()[name]), name
    torch.testing.assert_close(other.returns.scale, factor * one.returns.scale)


@pytest.mark.parametrize("added", [-100.0, 1000.0])
def test_a_constant_added_to_rewards_leaves_all_numbers_finite_and_of_one_size(added):
    model = trained(SPEC, [row + added for row in rewards()])

    assert all(bool(torch.isfinite(t).all()) for t in model.state_dict().values())
    assert model(seen(SPEC, STEPS)).value.abs().mean() < 10.0 * UNITS


@pytest.mark.parametrize("row", [0.0, 5.0, -3e4], ids=str)
def test_rewards_that_are_all_the_same_are_no_trouble(row):
    model = trained(replace(SPEC, state_dims=4), [np.full(STEPS, row)] * 3)

    assert all(bool(torch.isfinite(t).all()) for t in model.state_dict().values())


def test_an_episode_of_a_single_step_is_no_trouble():
    torch.manual_seed(0)
    model = ActorCritic(SPEC)

    PPO(model, CONFIG, CPU).update(played(model, np.array([4.0])), 1)

    assert all(bool(torch.isfinite(t).all()) for t in model.state_dict().values())
    assert model.returns.scale == 4.0 / UNITS


def test_a_fresh_critic_expects_nothing_in_any_unit():
    assert (said(ActorCritic(SPEC)) == 0.0).all()


@pytest.mark.parametrize("state_dims", [0, 4])
def test_a_new_scale_leaves_what_the_critic_says_as_it_is(state_dims):
    model = trained(replace(SPEC, state_dims=state_dims), rewards())
    before = said(model)

    model.follow_returns(torch.full((3,), 700.0).double(), torch.zeros(3).double())

    assert model.returns.scale > 20.0
    np.testing.assert_allclose(said(model), before, rtol=1e-4, atol=1e-5)


def test_the_scale_follows_returns_that_grow_with_skill():
    scale = ReturnScale()
    sizes = [1.0, 2.0, 4.0, 8.0, 16.0, 16.0, 16.0, 16.0]

    for size in sizes:
        scale.follow(torch.tensor(size).double(), torch.nn.Linear(1, 1))

    assert 0.7 * 16.0 < scale.scale * UNITS < 16.0


def test_one_outlier_does_not_decide_the_scale():
    model = ActorCritic(SPEC)
    usual, outlier = torch.ones(500).double(), torch.ones(500).double()
    outlier[7] = 1000.0
    model.follow_returns(usual, usual)

    model.follow_returns(outlier, usual)

    assert model.returns.scale * UNITS < 3.0


def test_returns_that_vanish_do_not_let_the_critics_outputs_grow():
    model = trained(SPEC, rewards())
    before = model(seen(SPEC, STEPS)).value.abs().max()

    for _ in range(300):
        values = torch.from_numpy(said(model))
        model.follow_returns(torch.zeros(STEPS).double(), values)

    assert model(seen(SPEC, STEPS)).value.abs().max() < 2.0 * max(before, UNITS)


def test_rewards_at_the_limit_in_the_longest_episode_stay_finite():
    torch.manual_seed(0)
    model = ActorCritic(SPEC)
    rollout = played(model, np.full(STEPS, 1e5))

    PPO(model, replace(CONFIG, discount_factor=1.0, gae_lambda=1.0, huber=False), CPU).update(
        replace(rollout, rewards=rollout.rewards * 10_000), 1
    )

    assert all(bool(torch.isfinite(p).all()) for p in model.parameters())


def test_a_checkpoint_of_version_0_1_0_says_what_it_said_and_learns_on():
    model = trained(SPEC, rewards())
    old = {n: t for n, t in model.state_dict().items() if not n.startswith("returns.")}
    units = model(seen(SPEC, STEPS)).value

    again = ActorCritic(SPEC)
    again.load_state_dict(old)

    np.testing.assert_array_equal(said(again), units.detach().double().numpy())
    PPO(again, CONFIG, CPU).update(played(again, rewards()[0]), 1)
    assert again.returns.weight > 0.0


def test_a_training_that_goes_on_from_its_checkpoint_is_the_same_to_the_byte():
    torch.manual_seed(0)
    first = PPO(ActorCritic(SPEC), CONFIG, CPU)
    first.update(played(first.model, rewards()[0]), 1)
    second = PPO(ActorCritic(SPEC), CONFIG, CPU)
    weights = {n: t.contiguous() for n, t in first.model.state_dict().items()}
    second.model.load_state_dict(load(save(weights)))
    second.optimizer.restore(load(save(first.optimizer.tensors())))

    for ppo in (first, second):
        ppo.update(played(ppo.model, rewards()[1]), 2)

    for name, tensor in first.model.state_dict().items():
        assert torch.equal(tensor, second.model.state_dict()[name]), name


def rewards() -> list[np.ndarray]:
    """Those of three iterations; they grow."""
    random = np.random.default_rng(3)
    return [size * (random.random(STEPS) - 0.2) for size in (1.0, 3.0, 5.0)]


def trained(spec: PolicySpec, iterations: list[np.ndarray]) -> ActorCritic:
    """A network after an update for each row of rewards, driven by itself in between."""
    torch.manual_seed(0)
    model = ActorCritic(spec)
    ppo = PPO(model, CONFIG, CPU)
    for number, row in enumerate(iterations):
        ppo.update(played(model, row), number)
    return model


def seen(spec: PolicySpec, steps: int):
    random = np.random.default_rng(0)
    frames = random.integers(0, 255, (steps, 1, 120, 160), dtype=np.uint8)
    states = random.random((steps, spec.state_dims), np.float32)
    return Observation.of_arrays(frames, np.empty((steps, 0), np.float32), states)


def said(model: ActorCritic) -> np.ndarray:
    """What the critic expects, in reward."""
    noise = np.zeros((STEPS, model.spec.noise_dims), np.float32)
    return decide(model, seen(model.spec, STEPS), noise, np.ones(STEPS, np.bool_)).values


def played(model: ActorCritic, row: np.ndarray) -> Rollout:
    """An episode whose end the step limit cut off."""
    steps = len(row)
    looked = seen(model.spec, steps)
    random = np.random.default_rng(1)
    shape = (steps, model.spec.noise_dims)
    noise = random.standard_normal(shape) if model.spec.continuous else random.random(shape)
    chosen = decide(model, looked, noise.astype(np.float32), np.zeros(steps, np.bool_))
    return Rollout(
        looked.frames.numpy(),
        chosen.actions,
        chosen.log_probs,
        chosen.values,
        row,
        np.array([steps]),
        last_values=chosen.values[-1:],
        cut=np.ones(1, np.bool_),
        scans=looked.scan.numpy(),
        states=looked.state.numpy(),
    )

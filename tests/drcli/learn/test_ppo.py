import numpy as np
import pytest
import torch

from drcli.learn.acting import decide
from drcli.learn.buffer import Rollout
from drcli.learn.policy import ActorCritic, PolicySpec
from drcli.learn.ppo import (
    PPO,
    NonFiniteLossError,
    PPOConfig,
    UpdateInterruptedError,
    _minibatches,
)
from drcli.learn.precision import Compute

CPU = Compute(torch.device("cpu"), bf16=False, reason="test")


def test_the_shallow_network_has_the_parameters_of_the_reference_body():
    body = ActorCritic(PolicySpec(14)).body

    assert sum(p.numel() for p in body.parameters()) == 5_839_520


@pytest.mark.parametrize("continuous", [False, True])
def test_an_update_makes_rewarded_actions_likelier(continuous):
    model = _model(continuous)
    frames = np.random.default_rng(0).integers(0, 255, (32, 120, 160), dtype=np.uint8)
    rollout = _rollout(model, frames)
    good = rollout.actions == 1 if not continuous else rollout.actions[:, 0] > 0
    rollout = _with(rollout, rewards=np.where(good, 1.0, -1.0).astype(np.float32))
    before = _preference(model, frames)

    PPO(model, PPOConfig(batch_size=16, num_epochs=4, discount_factor=0.0), CPU).update(rollout, 1)

    assert _preference(model, frames) > before


def test_same_seed_and_same_rollout_give_the_same_weights():
    weights = []
    for _ in range(2):
        model = _model(continuous=False)
        frames = np.random.default_rng(0).integers(0, 255, (20, 120, 160), dtype=np.uint8)
        PPO(model, PPOConfig(batch_size=8, num_epochs=1), CPU).update(_rollout(model, frames), 7)
        weights.append(model.policy_head.weight.detach().clone())

    assert torch.equal(weights[0], weights[1])


def test_a_reward_that_is_not_a_number_ends_the_update_at_the_first_step():
    model = _model(continuous=False)
    rollout = _rollout(model, np.zeros((8, 120, 160), dtype=np.uint8))
    broken = _with(rollout, rewards=np.full(8, np.nan, dtype=np.float32))
    before = model.policy_head.weight.detach().clone()

    with pytest.raises(NonFiniteLossError, match="nan"):
        PPO(model, PPOConfig(batch_size=4), CPU).update(broken, 1)

    assert torch.equal(model.policy_head.weight, before)


def test_an_update_can_be_interrupted_between_minibatches():
    model = _model(continuous=False)
    rollout = _rollout(model, np.zeros((8, 120, 160), dtype=np.uint8))
    answers = iter([False, True])

    with pytest.raises(UpdateInterruptedError):
        PPO(model, PPOConfig(batch_size=4), CPU).update(
            rollout, 1, should_stop=lambda: next(answers)
        )


def test_an_epoch_uses_full_minibatches_and_no_row_twice():
    rows = torch.cat(list(_minibatches(20, 8, torch.Generator().manual_seed(0))))

    assert len(rows) == 16
    assert len(set(rows.tolist())) == 16


def test_fewer_steps_than_a_minibatch_are_one_minibatch():
    batches = list(_minibatches(5, 64, torch.Generator().manual_seed(0)))

    assert [len(rows) for rows in batches] == [5]


def test_the_deterministic_cars_ignore_their_noise():
    model = _model(continuous=False)
    frames = np.random.default_rng(0).integers(0, 255, (4, 120, 160), dtype=np.uint8)
    yes = np.ones(4, dtype=bool)

    one = decide(model, frames, np.zeros(4, dtype=np.float32), yes)
    other = decide(model, frames, np.full(4, 0.99, dtype=np.float32), yes)

    np.testing.assert_array_equal(one.actions, other.actions)


def _model(continuous: bool) -> ActorCritic:
    torch.manual_seed(0)
    return ActorCritic(PolicySpec(2, continuous=continuous))


def _rollout(model: ActorCritic, frames: np.ndarray) -> Rollout:
    rng = np.random.default_rng(1)
    n = len(frames)
    noise = rng.standard_normal((n, 2)) if model.spec.continuous else rng.random(n)
    chosen = decide(model, frames, noise.astype(np.float32), np.zeros(n, dtype=bool))
    return Rollout(
        frames,
        chosen.actions,
        chosen.log_probs,
        chosen.values,
        rng.random(n).astype(np.float32),
        np.ones(n, dtype=np.int64),
    )


def _with(rollout: Rollout, rewards: np.ndarray) -> Rollout:
    return Rollout(
        rollout.frames,
        rollout.actions,
        rollout.log_probs,
        rollout.values,
        rewards,
        rollout.lengths,
    )


def _preference(model: ActorCritic, frames: np.ndarray) -> float:
    with torch.no_grad():
        policy, _ = model(torch.from_numpy(frames))
    column = policy[:, 0] if model.spec.continuous else policy.softmax(-1)[:, 1]
    return float(column.mean())

from dataclasses import replace

import numpy as np
import pytest
import torch

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute
from drcli.learn.policy import Observation, PolicySpec, decide
from drcli.learn.ppo import PPO, minibatches
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.update_result import NonFiniteLossError

CPU = Compute(torch.device("cpu"), bf16=False, reason="test")


@pytest.mark.parametrize("continuous", [False, True])
def test_an_update_makes_rewarded_actions_likelier(continuous):
    model = _model(continuous)
    frames = np.random.default_rng(0).integers(0, 255, (32, 1, 120, 160), dtype=np.uint8)
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
        frames = np.random.default_rng(0).integers(0, 255, (20, 1, 120, 160), dtype=np.uint8)
        PPO(model, PPOConfig(batch_size=8, num_epochs=1), CPU).update(_rollout(model, frames), 7)
        weights.append(model.policy_head.weight.detach().clone())

    assert torch.equal(weights[0], weights[1])


def test_a_reward_that_is_not_a_number_ends_the_update_at_the_first_step():
    model = _model(continuous=False)
    rollout = _rollout(model, np.zeros((8, 1, 120, 160), dtype=np.uint8))
    broken = _with(rollout, rewards=np.full(8, np.nan, dtype=np.float32))
    before = model.policy_head.weight.detach().clone()

    with pytest.raises(NonFiniteLossError, match="nan"):
        PPO(model, PPOConfig(batch_size=4), CPU).update(broken, 1)

    assert torch.equal(model.policy_head.weight, before)


def test_the_reward_in_place_of_a_failed_one_changes_nothing():
    weights = []
    for instead in (0.001, 90_000.0):
        model = _model(continuous=False)
        frames = np.random.default_rng(0).integers(0, 255, (20, 1, 120, 160), dtype=np.uint8)
        driven = _rollout(model, frames)
        rollout = replace(
            driven,
            rewards=np.where(np.arange(20) == 7, instead, driven.rewards),
            lengths=np.array([20]),
            last_values=np.zeros(1),
            cut=np.zeros(1, np.bool_),
            learned=np.arange(20) != 7,
        )

        PPO(model, PPOConfig(batch_size=19, num_epochs=2), CPU).update(rollout, 1)
        weights.append(model.policy_head.weight.detach())

    assert torch.equal(weights[0], weights[1])


def test_nothing_is_learned_from_a_rollout_without_a_known_reward():
    model = _model(continuous=False)
    rollout = _rollout(model, np.zeros((8, 1, 120, 160), dtype=np.uint8))
    before = model.value_head.bias.detach().clone()

    unknown = replace(rollout, learned=np.zeros(8, np.bool_))

    assert PPO(model, PPOConfig(batch_size=4), CPU).update(unknown, 1) == []
    assert torch.equal(model.value_head.bias, before)


def test_an_update_that_ends_early_has_learned_from_the_minibatches_until_then():
    model = _model(continuous=False)
    rollout = _rollout(model, np.zeros((8, 1, 120, 160), dtype=np.uint8))
    before = model.value_head.bias.detach().clone()
    answers, heard = iter([False, False, True]), []

    stats = PPO(model, PPOConfig(batch_size=4), CPU).update(
        rollout, 1, heard.append, should_stop=lambda: next(answers)
    )

    assert [s.epoch for s in stats] == [0, 1]
    assert heard == stats
    assert all(np.isfinite(s.value_loss) for s in stats)
    assert not torch.equal(model.value_head.bias, before)


def test_an_epoch_uses_full_minibatches_and_no_row_twice():
    rows = torch.cat(list(minibatches(torch.randperm(20), 8)))

    assert len(rows) == 16
    assert len(set(rows.tolist())) == 16


def test_fewer_steps_than_a_minibatch_are_one_minibatch():
    batches = list(minibatches(torch.arange(5), 64))

    assert [len(rows) for rows in batches] == [5]


def test_the_deterministic_cars_ignore_their_noise():
    model = _model(continuous=False)
    frames = np.random.default_rng(0).integers(0, 255, (4, 1, 120, 160), dtype=np.uint8)
    yes = np.ones(4, dtype=bool)

    one = decide(model, _seen(frames), np.zeros((4, 2), dtype=np.float32), yes)
    other = decide(model, _seen(frames), np.full((4, 2), 0.99, dtype=np.float32), yes)

    np.testing.assert_array_equal(one.actions, other.actions)


def test_blind_actions_come_as_often_as_epsilon_says():
    model = _model(continuous=False, actions=5)
    rng = np.random.default_rng(0)
    frames = np.repeat(rng.integers(0, 255, (1, 1, 120, 160), dtype=np.uint8), 400, axis=0)
    noise = rng.random((400, 2), dtype=np.float32)
    no = np.zeros(400, dtype=bool)

    drawn = decide(model, _seen(frames), noise, no, epsilon=0.5).actions
    best = decide(model, _seen(frames), noise, ~no).actions

    assert np.mean(drawn != best) == pytest.approx(0.5 * 4 / 5, abs=0.05)
    assert set(drawn.tolist()) == set(range(5))


def test_a_learning_rate_on_a_schedule_falls_to_a_twentieth_and_stays_there():
    config = PPOConfig(lr=1e-3, lr_schedule="linear", schedule_steps=1_000)

    rates = [config.lr_at(steps) for steps in (0, 500, 1_000, 9_000)]

    assert rates == pytest.approx([1e-3, 5e-4, 5e-5, 5e-5])


def test_the_entropy_bonus_follows_its_own_schedule():
    config = PPOConfig(lr=1e-3, beta_entropy=0.02, entropy_schedule="linear", schedule_steps=100)

    assert (config.lr_at(50), config.beta_entropy_at(50)) == pytest.approx((1e-3, 0.01))


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({}, True),
        ({"clip_range": 0.0001}, False),
        ({"gae_lambda": 0.0}, False),
        ({"discount_factor": 0.5}, False),
        ({"beta_entropy": 0.5}, False),
        ({"huber": False}, False),
        ({"lr": 1e-4}, False),
        ({"num_epochs": 1}, False),
        ({"batch_size": 4}, False),
        ({"adam_eps": 1e-2}, False),
        ({"clip_value": 0.001}, False),
        ({"clip_advantage": 0.1}, False),
        ({"target_kl": 1e-9}, False),
        ({"max_grad_norm": 0.01}, False),
        ({"lr_schedule": "linear"}, False),
        ({"entropy_schedule": "linear"}, False),
        ({"bootstrap_cut": True}, False),
    ],
    ids=str,
)
def test_each_knob_changes_what_is_learned(change, same):
    base = {"batch_size": 8, "num_epochs": 3, "lr": 1e-3, "schedule_steps": 100}

    before = _learned(PPOConfig(**base))
    after = _learned(PPOConfig(**(base | change)))

    assert torch.equal(before, after) is same


def test_an_update_ends_after_the_epoch_that_went_too_far():
    model = _model(continuous=False)
    frames = np.random.default_rng(0).integers(0, 255, (16, 1, 120, 160), dtype=np.uint8)
    config = PPOConfig(batch_size=4, num_epochs=5, lr=1e-3, target_kl=1e-9)

    stats = PPO(model, config, CPU).update(_rollout(model, frames), 1)

    assert len(stats) < 5


def test_each_epoch_reports_its_numbers_by_the_names_of_cleanrl():
    model = _model(continuous=False)
    frames = np.random.default_rng(0).integers(0, 255, (16, 1, 120, 160), dtype=np.uint8)
    heard = []

    stats = PPO(model, PPOConfig(batch_size=8, num_epochs=2, lr=1e-3), CPU).update(
        _rollout(model, frames), 1, on_epoch=heard.append
    )

    assert heard == stats
    assert [s.epoch for s in stats] == [0, 1]
    metrics = stats[-1].metrics()
    assert metrics["charts/learning_rate"] == 1e-3
    assert metrics["losses/explained_variance"] == 0.0  # a fresh critic always predicts 0
    assert metrics["losses/entropy"] == pytest.approx(np.log(2), rel=0.01)
    assert metrics["losses/approx_kl"] >= 0.0


def test_the_value_may_not_profit_from_moving_further_than_its_clip():
    ppo = PPO(_model(continuous=False), PPOConfig(huber=False, clip_value=0.5), CPU)
    value, before, target = torch.tensor([2.0]), torch.tensor([0.0]), torch.tensor([3.0])

    loss = ppo._value_loss(value, before, target)

    assert loss.item() == pytest.approx((0.5 - 3.0) ** 2)


def test_frames_are_seen_with_those_before_them_in_the_same_episode():
    rollout = replace(
        _rollout(_model(continuous=False), np.zeros((5, 1, 120, 160), np.uint8)),
        lengths=np.array([3, 2]),
    )

    rows = rollout.stacked_rows(3)

    np.testing.assert_array_equal(rows, [[0, 0, 0], [0, 0, 1], [0, 1, 2], [3, 3, 3], [3, 3, 4]])


def test_a_network_learns_from_stacked_frames_lidar_and_state():
    spec = PolicySpec(
        3, network="COMPACT_CONVOLUTIONAL_NETWORK", eyes=2, stack=2, scan_dims=8, state_dims=4
    )
    torch.manual_seed(0)
    model = ActorCritic(spec)
    rng = np.random.default_rng(0)
    rollout = Rollout(
        rng.integers(0, 255, (12, 2, 120, 160), dtype=np.uint8),
        rng.integers(0, 3, 12),
        np.full(12, -1.1, np.float32),
        np.zeros(12, np.float32),
        rng.random(12, np.float32),
        np.array([5, 7]),
        last_values=np.zeros(2, np.float32),
        cut=np.zeros(2, np.bool_),
        scans=rng.random((12, 8), np.float32),
        states=rng.random((12, 4), np.float32),
    )
    before = {name: p.detach().clone() for name, p in model.named_parameters()}

    PPO(model, PPOConfig(batch_size=6, num_epochs=2), CPU).update(rollout, 1)

    moved = [name for name, p in model.named_parameters() if not torch.equal(p, before[name])]
    assert moved == list(before)


def test_a_new_critic_learns_alone_until_its_warmup_is_over():
    model = _model(continuous=False)
    frames = np.random.default_rng(0).integers(0, 255, (16, 1, 120, 160), dtype=np.uint8)
    rollout = _rollout(model, frames)
    ppo = PPO(model, PPOConfig(batch_size=8, num_epochs=1), CPU)
    ppo.critic_warmup = 1
    before = {name: p.detach().clone() for name, p in model.named_parameters()}

    ppo.update(rollout, 1)
    alone = [name for name, p in model.named_parameters() if not torch.equal(p, before[name])]
    ppo.update(rollout, 2)
    both = [name for name, p in model.named_parameters() if not torch.equal(p, before[name])]

    assert alone == ["value_head.weight", "value_head.bias"]
    assert both == list(before)


def test_a_critic_that_explains_the_returns_needs_no_more_warmup():
    model = _model(continuous=False)
    frames = np.random.default_rng(0).integers(0, 255, (16, 1, 120, 160), dtype=np.uint8)
    rewards = np.random.default_rng(1).random(16).astype(np.float32)
    rollout = _with(_rollout(model, frames), rewards=rewards)
    rollout = replace(rollout, values=rewards.astype(np.float64))
    ppo = PPO(model, PPOConfig(batch_size=8, num_epochs=1, discount_factor=0.0), CPU)
    ppo.critic_warmup = 5
    before = model.policy_head.weight.detach().clone()

    ppo.update(rollout, 1)

    assert ppo.critic_warmup == 0
    assert not torch.equal(model.policy_head.weight, before)


def _learned(config: PPOConfig) -> torch.Tensor:
    """Weights after two updates on one rollout whose last episode was cut off."""
    model = _model(continuous=False)
    frames = np.random.default_rng(0).integers(0, 255, (16, 1, 120, 160), dtype=np.uint8)
    rollout = replace(
        _rollout(model, frames),
        lengths=np.array([10, 6]),
        last_values=np.array([0.0, 5.0], np.float32),
        cut=np.array([False, True]),
    )
    ppo = PPO(model, config, CPU)
    for iteration in range(2):
        ppo.update(rollout, 7, steps_before=50 * iteration)
    return model.policy_head.weight.detach().clone()


def _model(continuous: bool, actions: int = 2) -> ActorCritic:
    torch.manual_seed(0)
    network = "COMPACT_CONVOLUTIONAL_NETWORK"
    return ActorCritic(PolicySpec(actions, continuous=continuous, network=network))


def _seen(frames: np.ndarray) -> Observation:
    nothing = np.empty((len(frames), 0), np.float32)
    return Observation.of_arrays(frames, nothing, nothing)


def _rollout(model: ActorCritic, frames: np.ndarray) -> Rollout:
    rng = np.random.default_rng(1)
    n = len(frames)
    shape = (n, model.spec.noise_dims)
    noise = rng.standard_normal(shape) if model.spec.continuous else rng.random(shape)
    chosen = decide(model, _seen(frames), noise.astype(np.float32), np.zeros(n, dtype=bool))
    return Rollout(
        frames,
        chosen.actions,
        chosen.log_probs,
        chosen.values,
        rng.random(n).astype(np.float32),
        np.ones(n, dtype=np.int64),
        last_values=np.zeros(n, np.float32),
        cut=np.zeros(n, np.bool_),
        scans=np.empty((n, 0), np.float32),
        states=np.empty((n, 0), np.float32),
    )


def _with(rollout: Rollout, rewards: np.ndarray) -> Rollout:
    return replace(rollout, rewards=rewards)


def _preference(model: ActorCritic, frames: np.ndarray) -> float:
    with torch.no_grad():
        policy, _ = model(_seen(frames))
    column = policy[:, 0] if model.spec.continuous else policy.softmax(-1)[:, 1]
    return float(column.mean())

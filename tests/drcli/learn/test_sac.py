import functools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from drcli.learn.algorithms import SACConfig
from drcli.learn.compute import Compute
from drcli.learn.policy import Decision, Observation, PolicySpec, decide
from drcli.learn.replay_buffer import Transitions
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.sac import SAC
from drcli.learn.sac_networks import SACAgent
from drcli.learn.update_result import NonFiniteLossError
from observations import camera_only

CPU = Compute(torch.device("cpu"), bf16=False, reason="test")
SPEC = PolicySpec(2, continuous=True, network="COMPACT_CONVOLUTIONAL_NETWORK")
SMALL = SACConfig(
    batch_size=8, sac_replay_steps=200, sac_learning_starts=1, sac_updates_per_step=0.1, lr=1e-3
)


def test_targets_equal_two_steps_worked_by_hand():
    sac = SAC(_agent(), replace(SMALL, discount_factor=0.5, sac_alpha=0.1), CPU)
    sac.model.actor = _Constant(torch.zeros(2, 4))
    sac.model.targets = _Constant(torch.tensor([[3.0, 7.0], [4.0, 2.0]]))
    batch = _transitions(returns=[1.0, 2.0], discounts=[0.5, 0.0])

    target = sac._target(sac.model, batch, torch.zeros(2, 2), sac.alpha())

    # Mean 0, deviation 1, noise 0: log pi = -log 2 pi. The smaller critic says 3, then nothing.
    first = 1.0 + 0.5 * (3.0 + 0.1 * math.log(2.0 * math.pi))
    np.testing.assert_allclose(target, [first, 2.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("huber", "expected"),
    # Errors of 3 and 0.5 twice: squares 9 and 0.25, or Huber's 2.5 and 0.125.
    [(False, (9.0 + 0.25) / 2), (True, (2.5 + 0.125) / 2)],
)
def test_the_critics_loss_is_the_error_that_was_asked_for(huber, expected):
    sac = SAC(_agent(), replace(SMALL, huber=huber), CPU)

    critic_loss = sac._critic_loss(torch.zeros(2, 2), torch.tensor([3.0, 0.5])).item()

    assert critic_loss == pytest.approx(expected)


@pytest.mark.parametrize(("log_prob", "grows"), [(5.0, True), (-5.0, False)])
def test_the_temperature_grows_when_the_entropy_is_below_minus_one_for_each_dimension(
    log_prob, grows
):
    sac = SAC(_agent(), replace(SMALL, sac_auto_alpha=True), CPU)
    before = sac.alpha().item()

    sac._alpha_loss(sac.model, torch.full((4,), log_prob)).backward()
    sac.optimizer.step()

    assert (sac.alpha().item() > before) is grows


def test_the_temperature_rests_at_an_entropy_of_minus_one_for_each_dimension():
    sac = SAC(_agent(), replace(SMALL, sac_auto_alpha=True), CPU)

    sac._alpha_loss(sac.model, torch.full((4,), 2.0)).backward()

    assert sac.model.log_alpha.grad.item() == 0.0


def test_a_fixed_temperature_is_the_one_that_was_set_whatever_a_checkpoint_says():
    sac = SAC(SACAgent(SPEC, sac_alpha=0.7), replace(SMALL, sac_alpha=0.2), CPU)

    stats = sac.update(_rollout(), seed=1)

    assert stats[-1].alpha == pytest.approx(0.2)


def test_a_fixed_temperature_is_compared_with_returns_in_reward():
    sac = SAC(_agent(), replace(SMALL, sac_alpha=0.2, sac_learning_starts=1_000), CPU)

    # Twenty returns of 8 without a future: a unit is a fifth of them, 1.6.
    sac.config = replace(sac.config, discount_factor=0.0)
    sac.update(replace(_rollout(), rewards=np.full(20, 8.0)), seed=1)

    assert sac.model.returns.scale.item() == pytest.approx(1.6)
    assert sac.alpha().item() == pytest.approx(0.2 / 1.6)


@pytest.mark.parametrize("factor", [1e-3, 1e4])
def test_rewards_times_a_constant_train_to_the_same_byte_if_the_temperature_is_learned(factor):
    agents = []
    for scale in (1.0, factor):
        sac = SAC(_agent(), replace(SMALL, sac_auto_alpha=True, sac_alpha=0.02), CPU)
        for seed in range(2):
            rollout = _rollout(seed=seed)
            sac.update(replace(rollout, rewards=scale * rollout.rewards.astype(float)), seed=seed)
        agents.append(sac.model)

    one, other = (
        {n: t for n, t in agent.state_dict().items() if not n.startswith("returns.")}
        for agent in agents
    )
    assert [name for name in one if not torch.equal(one[name], other[name])] == []


def test_new_units_leave_what_critics_and_temperature_are_worth_as_they_are():
    sac = SAC(_agent(), replace(SMALL, sac_auto_alpha=True), CPU)
    sac.update(_rollout(), seed=1)
    frames = np.random.default_rng(0).integers(0, 255, (8, 1, 120, 160), dtype=np.uint8)
    model, before = sac.model, _drive(sac.model, frames).values
    worth = model.returns(sac.alpha())
    target = model.returns(model.targets(torch.ones(1, 256), torch.zeros(1, 2)))

    model.follow_returns(torch.full((3,), 700.0).double(), torch.zeros(3).double())

    np.testing.assert_allclose(_drive(model, frames).values, before, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(model.returns(sac.alpha()), worth, rtol=1e-5, atol=0.0)
    again = model.returns(model.targets(torch.ones(1, 256), torch.zeros(1, 2)))
    torch.testing.assert_close(again, target, rtol=1e-4, atol=1e-5)


def test_a_checkpoint_of_version_0_1_0_says_what_it_said_and_learns_on():
    sac = SAC(_agent(), SMALL, CPU)
    sac.update(_rollout(), seed=1)
    old = {n: t for n, t in sac.model.state_dict().items() if not n.startswith("returns.")}
    frames = np.random.default_rng(0).integers(0, 255, (8, 1, 120, 160), dtype=np.uint8)
    units = _drive(sac.model, frames).values / sac.model.returns.scale.item()

    again = SAC(SACAgent(SPEC), SMALL, CPU)
    again.model.load_state_dict(old)

    np.testing.assert_allclose(_drive(again.model, frames).values, units, rtol=1e-6)
    again.update(_rollout(seed=5), seed=2)
    assert again.model.returns.weight > 0.0


def test_a_return_that_is_infinite_ends_the_update_before_anything_is_learned_or_kept():
    sac = SAC(_agent(), SMALL, CPU)
    rewards = np.full(20, 1.0)
    rewards[3] = np.inf

    with pytest.raises(NonFiniteLossError, match="infinite"):
        sac.update(replace(_rollout(), rewards=rewards), seed=1)

    assert _same(sac.model, _agent())
    assert sac.replay.steps == 0


def test_the_target_critics_follow_by_tau():
    sac = SAC(_agent(), replace(SMALL, sac_tau=0.25, sac_updates_per_step=0.001), CPU)
    before = [p.clone() for p in sac.model.targets.parameters()]

    sac.update(_rollout(), seed=1)

    pairs = zip(before, sac.model.targets.parameters(), sac.model.critics.parameters(), strict=True)
    for old, new, critic in pairs:
        np.testing.assert_allclose(
            new.detach(), (0.75 * old + 0.25 * critic).detach(), rtol=1e-4, atol=1e-6
        )


def test_the_body_learns_from_the_critics_and_not_from_the_actor():
    agents = []
    for alpha in (0.0, 0.9):
        # Without a future the temperature is felt by the actor alone.
        config = replace(SMALL, sac_alpha=alpha, discount_factor=0.0, sac_updates_per_step=0.001)
        agents.append(SAC(_agent(), config, CPU))
        agents[-1].update(_rollout(), seed=1)

    calm, eager = (agent.model for agent in agents)
    start = _agent()
    assert _same(calm.body, eager.body)
    assert not _same(calm.body, start.body)
    assert not _same(calm.actor, eager.actor)


def test_a_critic_that_sees_the_state_leaves_the_body_to_the_actor():
    spec = replace(SPEC, scan_dims=8, state_dims=4, stack=2)
    torch.manual_seed(0)
    agent = SACAgent(spec)
    before = {name: p.detach().clone() for name, p in agent.named_parameters()}

    SAC(agent, SMALL, CPU).update(_rollout(spec=spec), seed=1)

    stayed = [name for name, p in agent.named_parameters() if torch.equal(p, before[name])]
    assert stayed == ["log_alpha"]


def test_on_a_single_picture_the_agent_learns_which_action_pays():
    config = replace(SMALL, discount_factor=0.0, sac_alpha=0.02, lr=2e-3, sac_updates_per_step=1.0)
    agent = _agent()
    sac = SAC(agent, config, CPU)
    before = _paid(_drive_calmly(agent)).item()
    for seed in range(3):
        driven = _rollout(agent, steps=50, one_picture=True, seed=seed)
        sac.update(replace(driven, rewards=_paid(driven.actions)), seed=seed)

    after = _paid(_drive_calmly(agent)).item()

    assert before < 0.1
    assert after > 0.5


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({}, True),
        ({"batch_size": 4}, False),
        ({"lr": 1e-4}, False),
        ({"discount_factor": 0.5}, False),
        ({"sac_alpha": 0.5}, False),
        ({"sac_auto_alpha": True}, False),
        ({"huber": True}, False),
        ({"sac_tau": 0.5}, False),
        ({"sac_n_step": 1}, False),
        ({"sac_updates_per_step": 0.2}, False),
        ({"sac_learning_starts": 30}, False),
        ({"sac_replay_steps": 15}, False),
    ],
    ids=str,
)
def test_each_knob_changes_what_is_learned(change, same):
    before = _learned_as_it_is()
    after = _learned(replace(SMALL, **change))

    assert torch.equal(before, after) is same


def test_a_replay_too_small_for_all_steps_before_learning_does_not_delay_it():
    sac = SAC(_agent(), replace(SMALL, sac_learning_starts=30, sac_replay_steps=15), CPU)
    sac.update(_rollout(), seed=1)

    assert len(sac.update(_rollout(), seed=2)) > 0


def test_nothing_is_learned_before_enough_steps_were_driven():
    sac = SAC(_agent(), replace(SMALL, sac_learning_starts=30), CPU)

    assert sac.update(_rollout(), seed=1) == []
    assert len(sac.update(_rollout(), seed=2)) > 0


def test_each_part_of_an_update_is_reported_as_it_ends():
    sac = SAC(_agent(), SMALL, CPU)
    heard = []

    stats = sac.update(_rollout(), seed=1, on_epoch=heard.append)

    assert heard == stats
    assert [s.epoch for s in stats] == [0, 1]
    assert all(math.isfinite(s.qf_loss) and math.isfinite(s.entropy) for s in stats)


def test_a_reward_that_is_not_a_number_ends_the_update_at_the_first_step():
    sac = SAC(_agent(), SMALL, CPU)

    with pytest.raises(NonFiniteLossError, match="nan"):
        sac.update(replace(_rollout(), rewards=np.full(20, np.nan, np.float32)), seed=1)

    assert _same(sac.model, _agent())


def test_an_update_that_ends_early_has_learned_with_the_gradient_steps_until_then():
    sac = SAC(_agent(), replace(SMALL, sac_updates_per_step=10.0), CPU)
    answers = iter([False, True])

    stats = sac.update(_rollout(), seed=1, should_stop=lambda: next(answers))

    assert [s.epoch for s in stats] == [0]
    assert math.isfinite(stats[0].qf_loss)
    assert not _same(sac.model, _agent())


def test_a_restored_learner_goes_on_as_the_first_one_would_have():
    first = SAC(_agent(), SMALL, CPU)
    first.update(_rollout(), seed=1)
    second = SAC(SACAgent(SPEC), SMALL, CPU)
    second.model.load_state_dict(first.model.state_dict())
    second.optimizer.restore(first.optimizer.tensors())
    second.replay.add(_rollout())

    for sac in (first, second):
        sac.update(_rollout(seed=5), seed=2)

    assert _same(first.model, second.model)


def test_actions_lie_within_the_borders_and_the_deterministic_cars_ignore_their_noise():
    frames = np.random.default_rng(0).integers(0, 255, (8, 1, 120, 160), dtype=np.uint8)
    agent = _agent()

    drawn = _drive(agent, frames)
    calm, again = (_drive(agent, frames, deterministic=True, seed=seed) for seed in (1, 2))

    assert np.abs(drawn.actions).max() <= 1.0
    assert drawn.log_probs.shape == drawn.values.shape == (8,)
    np.testing.assert_array_equal(calm.actions, again.actions)
    assert not np.array_equal(drawn.actions, calm.actions)


class _Constant(nn.Module):
    """Says the same whatever it is asked."""

    def __init__(self, value: torch.Tensor) -> None:
        super().__init__()
        self.value = nn.Parameter(value)

    def forward(self, *_: torch.Tensor) -> torch.Tensor:
        return self.value


def _agent() -> SACAgent:
    torch.manual_seed(0)
    return SACAgent(SPEC)


def _drive(
    agent: SACAgent, frames: np.ndarray, *, deterministic: bool = False, seed: int = 1
) -> Decision:
    n = len(frames)
    noise = np.random.default_rng(seed).standard_normal((n, agent.spec.noise_dims), np.float32)
    nothing = np.empty((n, 0), np.float32)
    return decide(
        agent, Observation.of_arrays(frames, nothing, nothing), noise, np.full(n, deterministic)
    )


def _drive_calmly(agent: SACAgent) -> np.ndarray:
    """What the agent does on the single picture."""
    return _drive(agent, np.full((1, 1, 120, 160), 99, np.uint8), deterministic=True).actions


def _paid(actions: np.ndarray) -> np.ndarray:
    """1 for the best action, less with the distance from it; 0 for doing nothing."""
    return 1.0 - np.abs(actions - np.array([0.5, -0.5], np.float32)).sum(1)


def _rollout(
    agent: SACAgent | None = None,
    *,
    spec: PolicySpec = SPEC,
    steps: int = 20,
    one_picture: bool = False,
    seed: int = 0,
) -> Rollout:
    """Two episodes; driven by the agent, else actions and rewards by chance."""
    rng = np.random.default_rng(seed)
    frames = (
        np.full((steps, 1, 120, 160), 99, np.uint8)
        if one_picture
        else rng.integers(0, 255, (steps, 1, 120, 160), dtype=np.uint8)
    )
    return Rollout(
        frames,
        rng.uniform(-1, 1, (steps, 2)).astype(np.float32)
        if agent is None
        else _drive(agent, frames, seed=seed).actions,
        np.zeros(steps, np.float32),
        np.zeros(steps, np.float32),
        rng.random(steps, np.float32),
        np.array([steps - 8, 8]),
        last_values=np.zeros(2, np.float32),
        cut=np.zeros(2, np.bool_),
        scans=rng.random((steps, spec.scan_dims), np.float32),
        states=rng.random((steps, spec.state_dims), np.float32),
    )


def _transitions(returns: list[float], discounts: list[float]) -> Transitions:
    n = len(returns)
    seen = camera_only(torch.zeros((n, 1, 120, 160), dtype=torch.uint8))
    total = torch.tensor(returns, dtype=torch.float64)
    return Transitions(seen, torch.zeros(n, 2), total, seen, torch.tensor(discounts))


def _learned(config: SACConfig) -> torch.Tensor:
    """Weights of the actor after two updates."""
    sac = SAC(_agent(), config, CPU)
    for iteration in range(2):
        sac.update(_rollout(seed=iteration), seed=iteration)
    return torch.cat([p.detach().flatten() for p in sac.model.actor.parameters()])


@functools.cache
def _learned_as_it_is() -> torch.Tensor:
    return _learned(SMALL)


def _same(one: nn.Module, other: nn.Module) -> bool:
    pairs = zip(one.state_dict().values(), other.state_dict().values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)

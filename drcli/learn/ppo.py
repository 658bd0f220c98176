"""Proximal policy optimization with a clipped objective (Schulman et al., 2017, equation 7)."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.nn.utils import clip_grad_norm_

from drcli.learn.actor_critic import PolicyAndValue
from drcli.learn.adam import Adam
from drcli.learn.advantages import explained_variance, gae, normalized
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute
from drcli.learn.cuda import CapturedStep, ReusedMemory
from drcli.learn.data_parallel import DataParallel, GradientGroup
from drcli.learn.learner import Learner
from drcli.learn.rollout_buffer import Rollout, RolloutTensors
from drcli.learn.update_result import (
    NonFiniteLossError,
    PPOStats,
    require_finite_losses,
    require_finite_weights,
)

WARMED_UP = 0.25
"""Share of the returns' variance that a new critic explains when the policy begins to learn from
it. In the middle of a training it is about half.
"""

NUM_STATISTICS = 5
"""Numbers in `PPOStats` that are means over minibatches."""

LOSSES = ("surrogate", "value", "entropy")


class PPO(Learner):
    """It cannot learn from rollouts of other weights."""

    model: PolicyAndValue
    config: PPOConfig

    def __init__(
        self,
        model: PolicyAndValue,
        config: PPOConfig,
        compute: Compute,
        group: GradientGroup | None = None,
    ) -> None:
        """Every process of a `group` makes the same updates of the same rollouts."""
        super().__init__(model, config, compute)
        self.optimizer = Adam(model.parameters(), config.lr, config.adam_eps)
        self._parallel = DataParallel(
            self.model,
            compute.parts,
            compute.threads,
            bf16=compute.bf16,
            group=group,
            num_statistics=NUM_STATISTICS,
        )
        # Of the present update.
        self._batch: RolloutTensors | None = None
        self._beta = torch.zeros((), device=compute.device)
        self._fixed: list[Tensor] = []
        captures = compute.graphs and group is None
        self._memory = ReusedMemory(compute.device) if captures else None
        self._step = CapturedStep(self._take_step, compute.device, enabled=captures)

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[PPOStats], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
        steps_before: int = 0,
    ) -> list[PPOStats]:
        """See `Learner.update`."""
        config = self.config
        history: list[PPOStats] = []
        learned = torch.from_numpy(np.flatnonzero(rollout.learned))
        if not len(learned):
            return history
        explained = self._prepare(rollout)
        order = torch.Generator().manual_seed(seed)
        self.optimizer.lr = self.lr_factor * config.lr_at(steps_before)
        self._beta.fill_(config.beta_entropy_at(steps_before))
        if explained >= WARMED_UP:
            self.critic_warmup = 0
        self._fix(self.model.without_critic() if self.critic_warmup else [])
        self.model.train()
        with self._parallel.optimizer_threads():
            for epoch in range(config.num_epochs):
                totals, count = torch.zeros(NUM_STATISTICS, device=self.compute.device), 0
                shuffled = learned[torch.randperm(len(learned), generator=order)].to(totals.device)
                ends = False
                for rows in minibatches(shuffled, config.batch_size):
                    totals += self._step(rows)
                    count += 1
                    if ends := should_stop():
                        break
                numbers = [*(totals / count).tolist(), explained]
                require_finite_losses(dict(zip(LOSSES, numbers, strict=False)))
                history.append(PPOStats(epoch, self.optimizer.lr, *numbers))
                on_epoch(history[-1])
                target_kl = config.target_kl
                if ends or (target_kl is not None and history[-1].approx_kl > target_kl):
                    break
        self._batch = None
        require_finite_weights(self.model)
        self.critic_warmup = max(0, self.critic_warmup - 1)
        return history

    def _take_step(self, rows: Tensor) -> Tensor:
        loss = partial(self._loss, rows)
        self.optimizer.zero_grad()
        statistics = self._parallel.backward(loss, len(rows))
        for parameter in self._fixed:
            parameter.grad = None  # so that the optimizer leaves it as it is
        if self.config.max_grad_norm is not None:
            clip_grad_norm_(self.model.parameters(), self.config.max_grad_norm)
        self.optimizer.step()
        return statistics

    def _fix(self, parameters: list[Tensor]) -> None:
        if len(parameters) != len(self._fixed):
            self._step.forget()
        self._fixed = parameters

    def _prepare(self, rollout: Rollout) -> float:
        """Put the data into place; returns the share of variance that the critic explained."""
        config, device = self.config, self.compute.device
        advantages = gae(
            rollout.rewards,
            rollout.values,
            rollout.lengths,
            config.discount_factor,
            config.gae_lambda,
            rollout.last_values if config.bootstrap_cut else None,
            rollout.learned,
        )
        values = torch.from_numpy(np.asarray(rollout.values, np.float64)).to(device)
        targets = advantages + rollout.values
        returns = torch.from_numpy(targets).to(device)
        if not bool(torch.isfinite(returns).all()):
            raise NonFiniteLossError("A return is nan or infinite.")
        known = torch.from_numpy(rollout.learned).to(device)
        self.model.follow_returns(returns[known], values[known])
        better = np.zeros(rollout.steps)
        better[rollout.learned] = normalized(advantages[rollout.learned])
        clip = np.inf if config.clip_advantage is None else config.clip_advantage
        moves = 0 if self._memory is None else self._memory.moves
        self._batch = RolloutTensors.of(
            rollout,
            self.model.spec.stack,
            self.model.block if self.compute.bf16 else 1,
            values=self.model.returns.units(values),
            advantages=better.clip(-clip, clip),
            returns=self.model.returns.units(returns),
            memory=self._memory,
        )
        if self._memory is not None:
            self._step.enabled = self._batch.frames.is_cuda
            if self._memory.moves != moves:
                self._step.forget()
        return explained_variance(rollout.values[rollout.learned], targets[rollout.learned])

    def _loss(self, rows: Tensor, model: PolicyAndValue, part: slice) -> tuple[Tensor, Tensor]:
        """The loss of a part of a minibatch, and its means of the numbers in `PPOStats`."""
        batch, rows = self._batch, rows[part]
        assert batch is not None
        advantages = batch.advantages[rows]
        policy, value = model(batch.observation(rows))
        log_ratio = model.log_prob(policy, batch.actions[rows]) - batch.log_probs[rows]
        ratio = log_ratio.exp()
        low, high = 1.0 - self.config.clip_range, 1.0 + self.config.clip_range
        surrogate = torch.minimum(ratio * advantages, ratio.clamp(low, high) * advantages)
        policy_loss = -surrogate.mean()
        value_loss = self._value_loss(value, batch.values[rows], batch.returns[rows])
        entropy = model.entropy(policy).mean()
        loss = policy_loss + value_loss - self._beta * entropy
        if self.config.smoothness:
            after = model(batch.observation(batch.following[rows])).policy
            if not model.spec.continuous:
                after, policy = after.softmax(-1), policy.softmax(-1)
            loss = loss + self.config.smoothness * (after - policy).square().sum(-1).mean()

        if not loss.is_cuda and not bool(torch.isfinite(loss)):
            raise NonFiniteLossError(
                f"The loss is {loss.item()} (surrogate {policy_loss.item():.4g}, "
                f"value {value_loss.item():.4g}, entropy {entropy.item():.4g})."
            )
        with torch.no_grad():
            # The third estimator of Schulman's "Approximating KL divergence": unbiased, positive.
            kl = (ratio - 1.0 - log_ratio).mean()
            clipped = ((ratio - 1.0).abs() > self.config.clip_range).float().mean()
            return loss, torch.stack([policy_loss, value_loss, entropy, kl, clipped])

    def _value_loss(self, value: Tensor, before: Tensor, returns: Tensor) -> Tensor:
        """With `clip_value`, a larger change from `before` gains nothing."""
        error = functional.huber_loss if self.config.huber else functional.mse_loss
        if self.config.clip_value is None:
            return error(value, returns)
        bound = self.config.clip_value
        near = before + (value - before).clamp(-bound, bound)
        return torch.maximum(
            error(value, returns, reduction="none"), error(near, returns, reduction="none")
        ).mean()


def minibatches(rows: Tensor, batch_size: int) -> Iterator[Tensor]:
    """Shuffled row numbers in full minibatches; the reference leaves out the remainder, too.

    If there are fewer steps than `batch_size`, they are one minibatch.
    """
    size = min(batch_size, len(rows))
    for start in range(0, len(rows) - size + 1, size):
        yield rows[start : start + size]

"""Proximal policy optimization with a clipped objective (Schulman et al., 2017, equation 7)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from drcli.learn import distributions
from drcli.learn.buffer import Rollout
from drcli.learn.gae import gae
from drcli.learn.policy import ActorCritic
from drcli.learn.precision import Compute


class NonFiniteLossError(ArithmeticError):
    """The loss became NaN or infinite; the weights of this update are not to be kept."""


class UpdateInterruptedError(RuntimeError):
    """The caller asked to stop in the middle of an update; its weights are not to be kept."""


@dataclass(frozen=True)
class PPOConfig:
    """Knobs of the update, under the names of hyperparameters.json where it has them.

    The clip range, lambda and Adam's epsilon are constants of the reference.
    """

    batch_size: int = 64
    num_epochs: int = 10
    lr: float = 3e-4
    discount_factor: float = 0.999
    beta_entropy: float = 0.01
    huber: bool = True
    clip_range: float = 0.2
    gae_lambda: float = 0.95
    adam_eps: float = 1e-5


@dataclass(frozen=True)
class EpochStats:
    """Means over the minibatches of one epoch."""

    epoch: int
    surrogate_loss: float
    value_loss: float
    entropy: float
    kl: float
    clip_fraction: float


class PPO:
    """The learner: a network, its optimizer, and the update that improves the former."""

    def __init__(self, model: ActorCritic, config: PPOConfig, compute: Compute) -> None:
        self.model = model.to(compute.device)
        self.config = config
        self.compute = compute
        self.optimizer = torch.optim.Adam(
            model.parameters(), lr=config.lr, eps=config.adam_eps, fused=True
        )

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[EpochStats], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> list[EpochStats]:
        """Improve the policy on one iteration of driving.

        Args:
            rollout: The episodes, played by the present weights.
            seed: Decides the order of the minibatches.
            on_epoch: Called after each epoch.
            should_stop: Asked before each minibatch.

        Raises:
            NonFiniteLossError: At the first loss that is NaN or infinite.
            UpdateInterruptedError: When `should_stop` said so.
        """
        batch = _Batch.prepare(rollout, self.config, self.compute.device)
        order = torch.Generator().manual_seed(seed)
        history = []
        self.model.train()
        for epoch in range(self.config.num_epochs):
            sums = torch.zeros(5)
            count = 0
            for rows in _minibatches(rollout.steps, self.config.batch_size, order):
                if should_stop():
                    raise UpdateInterruptedError
                sums += self._step(batch, rows.to(self.compute.device))
                count += 1
            history.append(EpochStats(epoch, *(sums / count).tolist()))
            on_epoch(history[-1])
        return history

    def _step(self, batch: "_Batch", rows: Tensor) -> Tensor:
        """One gradient step.

        Returns:
            Surrogate loss, value loss, entropy, KL divergence and clipped share. Shape (5,).
        """
        advantages = batch.advantages[rows]
        with self.compute.autocast():
            policy, value = self.model(batch.frames[rows])
        log_probs = distributions.log_prob(self.model, policy, batch.actions[rows])
        log_ratio = log_probs - batch.log_probs[rows]
        ratio = log_ratio.exp()
        low, high = 1.0 - self.config.clip_range, 1.0 + self.config.clip_range
        surrogate = torch.minimum(ratio * advantages, ratio.clamp(low, high) * advantages)
        value_loss = self._value_loss(value, batch.targets[rows])
        entropy = distributions.entropy(self.model, policy).mean()
        surrogate_loss = -surrogate.mean()
        loss = surrogate_loss + value_loss - self.config.beta_entropy * entropy

        if not bool(torch.isfinite(loss)):
            raise NonFiniteLossError(
                f"The loss is {loss.item()} (surrogate {surrogate_loss.item():.4g}, "
                f"value {value_loss.item():.4g}, entropy {entropy.item():.4g})."
            )
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()

        with torch.no_grad():
            # The third estimator of Schulman's "Approximating KL divergence": unbiased, positive.
            kl = (ratio - 1.0 - log_ratio).mean()
            clipped = ((ratio - 1.0).abs() > self.config.clip_range).float().mean()
            return torch.stack([surrogate_loss, value_loss, entropy, kl, clipped]).cpu()

    def _value_loss(self, value: Tensor, target: Tensor) -> Tensor:
        if self.config.huber:
            return functional.huber_loss(value, target)
        return functional.mse_loss(value, target)


@dataclass(frozen=True)
class _Batch:
    """A rollout with its advantages, as tensors on the learner's device."""

    frames: Tensor
    actions: Tensor
    log_probs: Tensor
    advantages: Tensor
    targets: Tensor

    @staticmethod
    def prepare(rollout: Rollout, config: PPOConfig, device: torch.device) -> "_Batch":
        advantages = gae(
            rollout.rewards,
            rollout.values,
            rollout.lengths,
            config.discount_factor,
            config.gae_lambda,
        )
        targets = advantages + rollout.values
        normalized = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        columns = (rollout.frames, rollout.actions, rollout.log_probs, normalized, targets)
        return _Batch(*(torch.from_numpy(np.ascontiguousarray(c)).to(device) for c in columns))


def _minibatches(steps: int, batch_size: int, order: torch.Generator) -> Iterator[Tensor]:
    """Shuffled row numbers, in full minibatches.

    The remainder is left out, as in the reference; each epoch leaves out different rows. Fewer
    steps than a minibatch are one minibatch.
    """
    size = min(batch_size, steps)
    rows = torch.randperm(steps, generator=order)
    for start in range(0, steps - size + 1, size):
        yield rows[start : start + size]

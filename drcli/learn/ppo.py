"""Proximal policy optimization with a clipped objective (Schulman et al., 2017, equation 7)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from drcli.learn.adam import Adam
from drcli.learn.data_parallel import Crew
from drcli.learn.gae import gae
from drcli.learn.observation import Observation
from drcli.learn.policy import ActorCritic
from drcli.learn.precision import Compute
from drcli.learn.rollout_buffer import Rollout

ROUNDING = 1e-9
"""Advantages that differ by less than this share of their size are equal."""

SCHEDULE_END = 0.05
"""Share of a knob that is left at the end of its schedule: a training that runs on still learns."""


class NonFiniteLossError(ArithmeticError):
    """The loss became NaN or infinite; the weights of this update are not to be kept."""


class UpdateInterruptedError(RuntimeError):
    """The caller asked to stop in the middle of an update; its weights are not to be kept."""


@dataclass(frozen=True)
class PPOConfig:
    """Knobs of the update, under the names of hyperparameters.json.

    Clip range, lambda and Adam's epsilon are the reference's constants unless set otherwise.

    Attributes:
        batch_size: Steps in a minibatch.
        num_epochs: Passes over a rollout.
        lr: Adam's learning rate.
        discount_factor: Weight of a reward one step later.
        beta_entropy: Weight of the entropy in the loss.
        huber: Huber's loss for the value, with delta 1, instead of the squared error. The value
            is in the critic's own units, of which the returns' mean size is `popart.UNITS`.
        clip_range: How far the ratio of new to old probabilities may leave 1 with profit.
        gae_lambda: Weight of longer returns in the advantage.
        adam_eps: Added to the root of Adam's second moment.
        clip_value: How far the value may move from what it was, with profit, in the critic's own
            units; None: any.
        clip_advantage: Largest normalised advantage; None: any.
        target_kl: The update ends after the epoch whose mean divergence from the policy that
            drove exceeds this; None: never.
        max_grad_norm: Largest norm of the gradient of a minibatch; None: any.
        lr_linear: Let `lr` fall over `schedule_steps`.
        entropy_linear: Let `beta_entropy` fall likewise.
        schedule_steps: Environment steps after which such a knob has reached `SCHEDULE_END`.
        bootstrap_cut: Count the critic's estimate as the rest of an episode that the step limit
            cut off; the reference counts nothing.
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
    clip_value: float | None = None
    clip_advantage: float | None = None
    target_kl: float | None = None
    max_grad_norm: float | None = None
    lr_linear: bool = False
    entropy_linear: bool = False
    schedule_steps: int = 500_000
    bootstrap_cut: bool = False

    def lr_at(self, steps: int) -> float:
        """The learning rate after so many environment steps."""
        return self.lr * (self._falling(steps) if self.lr_linear else 1.0)

    def beta_entropy_at(self, steps: int) -> float:
        """The weight of the entropy after so many environment steps."""
        return self.beta_entropy * (self._falling(steps) if self.entropy_linear else 1.0)

    def _falling(self, steps: int) -> float:
        return max(SCHEDULE_END, 1.0 - steps / self.schedule_steps)


@dataclass(frozen=True)
class EpochStats:
    """Means over the minibatches of one epoch."""

    epoch: int
    surrogate_loss: float
    value_loss: float
    entropy: float
    kl: float
    clip_fraction: float
    lr: float


class PPO:
    """The learner: a network, its optimizer, and the update that improves the former.

    Attributes:
        model: The network.
        memory_steps: Steps of earlier rollouts that it learns from again: none.
    """

    memory_steps = 0

    def __init__(self, model: ActorCritic, config: PPOConfig, compute: Compute) -> None:
        self.model = model.to(compute.device)
        self.config = config
        self.compute = compute
        self.optimizer = Adam(model.parameters(), config.lr, config.adam_eps)
        self._crew = Crew(self.model, compute.parts, compute.threads)

    def optimizer_tensors(self) -> dict[str, Tensor]:
        """The optimizer's memory, to go on with."""
        return self.optimizer.tensors()

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take up the memory of another optimizer."""
        self.optimizer.restore(tensors)

    def remember(self, rollout: Rollout) -> None:
        """Nothing: what other weights drove teaches this algorithm nothing."""

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[EpochStats], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
        steps_before: int = 0,
    ) -> list[EpochStats]:
        """Improve the policy on one iteration of driving.

        Args:
            rollout: The episodes, played by the present weights.
            seed: Decides the order of the minibatches.
            on_epoch: Called after each epoch.
            should_stop: Asked before each minibatch.
            steps_before: Environment steps learned from until now, for the schedules.

        Raises:
            NonFiniteLossError: At the first loss, and at weights, that are NaN or infinite.
            UpdateInterruptedError: When `should_stop` said so.
        """
        batch = _Batch.prepare(rollout, self.config, self.model)
        order = torch.Generator().manual_seed(seed)
        lr = self.config.lr_at(steps_before)
        self.optimizer.lr = lr
        beta = self.config.beta_entropy_at(steps_before)
        history = []
        self.model.train()
        for epoch in range(self.config.num_epochs):
            sums = torch.zeros(5)
            count = 0
            for rows in _minibatches(rollout.steps, self.config.batch_size, order):
                if should_stop():
                    raise UpdateInterruptedError
                sums += self._step(batch, rows.to(self.compute.device), beta)
                count += 1
            surrogate, value, entropy, kl, clipped = (sums / count).tolist()
            history.append(EpochStats(epoch, surrogate, value, entropy, kl, clipped, lr))
            on_epoch(history[-1])
            if self.config.target_kl is not None and history[-1].kl > self.config.target_kl:
                break
        if not all(bool(torch.isfinite(p).all()) for p in self.model.parameters()):
            raise NonFiniteLossError("The weights are no numbers any more.")
        return history

    def _step(self, batch: "_Batch", rows: Tensor, beta_entropy: float) -> Tensor:
        """One gradient step.

        Returns:
            Surrogate loss, value loss, entropy, KL divergence and clipped share. Shape (5,).
        """
        figures = self._crew.step(
            lambda model, part: self._loss(model, batch, rows[part], beta_entropy),
            len(rows),
            self._descend,
        )
        return figures.cpu()

    def _descend(self) -> None:
        """Let the optimizer act on the gradient."""
        if self.config.max_grad_norm is not None:
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.config.max_grad_norm)
        self.optimizer.step()

    def _loss(
        self, model: ActorCritic, batch: "_Batch", rows: Tensor, beta_entropy: float
    ) -> tuple[Tensor, Tensor]:
        """The loss of some steps, and the figures of `_step`."""
        advantages = batch.advantages[rows]
        with self.compute.autocast():
            policy, value = model(batch.observation(rows))
        log_probs = model.log_prob(policy, batch.actions[rows])
        log_ratio = log_probs - batch.log_probs[rows]
        ratio = log_ratio.exp()
        low, high = 1.0 - self.config.clip_range, 1.0 + self.config.clip_range
        surrogate = torch.minimum(ratio * advantages, ratio.clamp(low, high) * advantages)
        value_loss = self._value_loss(value, batch.values[rows], batch.targets[rows])
        entropy = model.entropy(policy).mean()
        surrogate_loss = -surrogate.mean()
        loss = surrogate_loss + value_loss - beta_entropy * entropy

        if not bool(torch.isfinite(loss)):
            raise NonFiniteLossError(
                f"The loss is {loss.item()} (surrogate {surrogate_loss.item():.4g}, "
                f"value {value_loss.item():.4g}, entropy {entropy.item():.4g})."
            )
        with torch.no_grad():
            # The third estimator of Schulman's "Approximating KL divergence": unbiased, positive.
            kl = (ratio - 1.0 - log_ratio).mean()
            clipped = ((ratio - 1.0).abs() > self.config.clip_range).float().mean()
            return loss, torch.stack([surrogate_loss, value_loss, entropy, kl, clipped])

    def _value_loss(self, value: Tensor, before: Tensor, target: Tensor) -> Tensor:
        loss = functional.huber_loss if self.config.huber else functional.mse_loss
        if self.config.clip_value is None:
            return loss(value, target)
        bound = self.config.clip_value
        near = before + (value - before).clamp(-bound, bound)
        return torch.maximum(
            loss(value, target, reduction="none"), loss(near, target, reduction="none")
        ).mean()


@dataclass(frozen=True)
class _Batch:
    """A rollout with its advantages, as tensors on the learner's device.

    Values and targets are in the critic's own units.
    """

    frames: Tensor
    frame_rows: Tensor
    scans: Tensor
    states: Tensor
    actions: Tensor
    log_probs: Tensor
    values: Tensor
    advantages: Tensor
    targets: Tensor

    @staticmethod
    def prepare(rollout: Rollout, config: PPOConfig, model: ActorCritic) -> "_Batch":
        """Work the advantages out, and let the critic's units follow the returns.

        Raises:
            NonFiniteLossError: A return is NaN or infinite; nothing was changed.
        """
        advantages = gae(
            rollout.rewards,
            rollout.values,
            rollout.lengths,
            config.discount_factor,
            config.gae_lambda,
            rollout.last_values if config.bootstrap_cut else None,
        )
        device = model.returns.scale.device
        values = torch.from_numpy(np.asarray(rollout.values, np.float64)).to(device)
        targets = torch.from_numpy(advantages + rollout.values).to(device)
        if not bool(torch.isfinite(targets).all()):
            raise NonFiniteLossError("A return is nan or infinite.")
        model.follow_returns(targets, values)
        normalized = _normalized(advantages)
        if config.clip_advantage is not None:
            normalized = normalized.clip(-config.clip_advantage, config.clip_advantage)

        def own(column: NDArray[Any]) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(column)).to(device)

        return _Batch(
            frames=own(rollout.frames),
            frame_rows=own(rollout.stacked_rows(model.spec.stack)),
            scans=own(rollout.scans),
            states=own(rollout.states),
            actions=own(rollout.actions),
            log_probs=own(rollout.log_probs),
            values=model.returns.units(values),
            advantages=own(normalized.astype(np.float32)),
            targets=model.returns.units(targets),
        )

    def observation(self, rows: Tensor) -> Observation:
        """What was seen at some steps."""
        # index_select copies whole frames; indexing with two dimensions is several times slower.
        frames = self.frames.index_select(0, self.frame_rows[rows].flatten())
        frames = frames.view(len(rows), -1, *self.frames.shape[2:])
        return Observation(frames, self.scans[rows], self.states[rows])


def _normalized(advantages: NDArray[np.float64]) -> NDArray[np.float64]:
    """Advantages with mean 0 and deviation 1; all 0 where they differ by rounding errors only.

    No constant is added to the deviation: it would count for more the smaller the rewards are.
    """
    centered = advantages - advantages.mean()
    std = centered.std()
    if std <= ROUNDING * np.abs(advantages).max():
        return np.zeros_like(advantages)
    normalized: NDArray[np.float64] = centered / std
    return normalized


def _minibatches(steps: int, batch_size: int, order: torch.Generator) -> Iterator[Tensor]:
    """Shuffled row numbers, in full minibatches.

    The remainder is left out, as in the reference; each epoch leaves out different rows. Fewer
    steps than a minibatch are one minibatch.
    """
    size = min(batch_size, steps)
    rows = torch.randperm(steps, generator=order)
    for start in range(0, steps - size + 1, size):
        yield rows[start : start + size]

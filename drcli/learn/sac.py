"""Soft actor-critic (Haarnoja et al., 2018b): the update."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.func import functional_call
from torch.nn import functional

from drcli.learn.adam import Adam
from drcli.learn.data_parallel import Crew
from drcli.learn.ppo import EpochStats, NonFiniteLossError, UpdateInterruptedError
from drcli.learn.precision import Compute
from drcli.learn.replay_buffer import Replay, Transitions
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.sac_networks import SACAgent, squash

UPDATES_PER_STEP = {"cpu": 0.5, "cuda": 1.0}
"""Gradient steps for each environment step. The reference makes 1, which on a processor takes far
longer than driving."""

REPORTS = 4
"""Into how many parts an update is divided for its reports."""


@dataclass(frozen=True)
class SACConfig:
    """Knobs of the update, under the names of hyperparameters.json.

    Attributes:
        batch_size: Steps in a minibatch.
        lr: Adam's learning rate, for all networks and the temperature.
        discount_factor: Weight of a reward one step later.
        sac_alpha: Temperature: what one nat of entropy is worth in reward.
        auto_alpha: Let the temperature find the value at which the policy's entropy is
            -1 nat for each dimension of an action; it begins at `sac_alpha`.
        huber: Huber's loss for the critics, with delta 1, instead of the squared error.
        tau: How far the target critics follow the critics at each gradient step. They lag
            1 / tau steps behind; the reference copies them outright after every
            `num_episodes_between_training` steps, n, and lags n / 2 on average: tau = 2 / n.
        updates_per_step: Gradient steps for each environment step; None: `UPDATES_PER_STEP`.
        learning_starts: Environment steps to drive before the first gradient step.
        replay_steps: Environment steps that are remembered.
    """

    batch_size: int = 64
    lr: float = 3e-4
    discount_factor: float = 0.999
    sac_alpha: float = 0.2
    auto_alpha: bool = False
    huber: bool = False
    tau: float = 0.02
    updates_per_step: float | None = None
    learning_starts: int = 1_000
    replay_steps: int = 100_000


@dataclass(frozen=True)
class SACStats(EpochStats):
    """Means over a part of an update: the critics' loss as `value_loss`, the actor's as surrogate.

    Divergence and clipped share do not exist here and are 0.

    Attributes:
        alpha: Temperature.
        value: What the critics expect of the steps learned from.
    """

    alpha: float
    value: float


class SAC:
    """The learner: an agent, its memory, its optimizer, and the update that improves it."""

    def __init__(self, model: SACAgent, config: SACConfig, compute: Compute) -> None:
        self.model = model.to(compute.device)
        self.config = config
        self.compute = compute
        self.updates_per_step = config.updates_per_step or UPDATES_PER_STEP[compute.device.type]
        self.replay = Replay(model.spec, config.replay_steps)
        learned = [p for p in model.parameters() if p.requires_grad]
        self.optimizer = Adam(learned, config.lr)
        self._crew = Crew(self.model, compute.parts, compute.threads)

    @property
    def memory_steps(self) -> int:
        """Steps of earlier rollouts that it still learns from."""
        return self.config.replay_steps

    def remember(self, rollout: Rollout) -> None:
        """Take up a rollout of an earlier iteration without learning from it now."""
        self.replay.add(rollout)

    def optimizer_tensors(self) -> dict[str, Tensor]:
        """The optimizer's memory, for a checkpoint; the replay is not among it."""
        return self.optimizer.tensors()

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take up the memory of another optimizer; the replay fills by `remember`."""
        self.optimizer.restore(tensors)

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[EpochStats], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
        steps_before: int = 0,
    ) -> list[SACStats]:
        """Remember one iteration of driving, and improve on what is remembered.

        Args:
            rollout: Episodes, by whatever weights.
            seed: Decides all random numbers of the update.
            on_epoch: Called after each part of the update.
            should_stop: Asked before each gradient step.
            steps_before: Environment steps learned from until now; no knob depends on them here.

        Returns:
            One for each part; none before `learning_starts`.

        Raises:
            NonFiniteLossError: At the first loss, and at weights, that are NaN or infinite.
            UpdateInterruptedError: When `should_stop` said so.
        """
        self.replay.add(rollout)
        if self.replay.taken_in < self.config.learning_starts or not self.replay.transitions:
            return []
        draw = torch.Generator().manual_seed(seed)
        total = max(1, round(rollout.steps * self.updates_per_step))
        parts = min(REPORTS, total)
        history = []
        self.model.train()
        for part in range(parts):
            sums = torch.zeros(5)
            count = total * (part + 1) // parts - total * part // parts
            for _ in range(count):
                if should_stop():
                    raise UpdateInterruptedError
                sums += self._step(draw)
            actor, critic, entropy, alpha, value = (sums / count).tolist()
            stats = SACStats(part, actor, critic, entropy, 0.0, 0.0, self.config.lr, alpha, value)
            history.append(stats)
            on_epoch(stats)
        if not all(bool(torch.isfinite(p).all()) for p in self.model.parameters()):
            raise NonFiniteLossError("The weights are no numbers any more.")
        return history

    def _step(self, draw: torch.Generator) -> Tensor:
        """One gradient step.

        Returns:
            Actor's loss, critics' loss, entropy, temperature and value. Shape (5,).
        """
        batch = self.replay.sample(self.config.batch_size, draw)
        noise = torch.randn((2, *batch.actions.shape), generator=draw)
        alpha = self.alpha()
        figures = self._crew.step(
            lambda model, part: self._loss(model, batch.part(part), noise[:, part], alpha),
            len(batch.rewards),
            self._descend,
        )
        return figures.cpu()

    def _descend(self) -> None:
        """Let the optimizer act on the gradient, and the targets follow."""
        self.optimizer.step()
        with torch.no_grad():
            for target, p in zip(
                self.model.targets.parameters(), self.model.critics.parameters(), strict=True
            ):
                target.lerp_(p, self.config.tau)

    def _loss(
        self, model: SACAgent, batch: Transitions, noise: Tensor, alpha: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The loss of some steps, and the figures of `_step`."""
        batch = batch.to(self.compute.device)
        here, there = noise.to(self.compute.device).unbind()

        with self.compute.autocast():
            features = model.features(batch.before)
        target = self._target(model, batch, there, alpha)
        values = model.critics(model.judged(features, batch.before), batch.actions)
        critic_loss = self._critic_loss(values, target)

        # The body learns from one of the two losses only, see SACAgent.
        mean, log_std = model(features if model.spec.state_dims else features.detach())
        actions, log_probs = squash(mean, log_std, here)
        seen = model.judged(features.detach(), batch.before)
        fixed = {name: p.detach() for name, p in model.critics.named_parameters()}
        worth: Tensor = functional_call(model.critics, fixed, (seen, actions)).amin(0)
        actor_loss = (alpha * log_probs - worth).mean()
        loss = critic_loss + actor_loss
        if self.config.auto_alpha:
            loss = loss + self._alpha_loss(model, log_probs.detach())

        if not bool(torch.isfinite(loss)):
            raise NonFiniteLossError(
                f"The loss is {loss.item()} (actor {actor_loss.item():.4g}, "
                f"critics {critic_loss.item():.4g}, temperature {alpha.item():.4g})."
            )
        with torch.no_grad():
            means = (actor_loss, critic_loss, -log_probs.mean(), alpha, values.mean())
            return loss, torch.stack(means)

    def alpha(self) -> Tensor:
        """The temperature now, without gradient."""
        if self.config.auto_alpha:
            return self.model.log_alpha.detach().exp()
        return torch.tensor(self.config.sac_alpha, device=self.compute.device)

    def _target(self, model: SACAgent, batch: Transitions, noise: Tensor, alpha: Tensor) -> Tensor:
        """What the critics should have said: r + gamma * (min Q' - alpha * log pi). Shape (n,)."""
        with torch.no_grad():
            with self.compute.autocast():
                features = model.features(batch.after)
            mean, log_std = model(features)
            actions, log_probs = squash(mean, log_std, noise)
            worth: Tensor = model.targets(model.judged(features, batch.after), actions).amin(0)
            discount = self.config.discount_factor * batch.goes_on
            return batch.rewards + discount * (worth - alpha * log_probs)

    def _critic_loss(self, values: Tensor, target: Tensor) -> Tensor:
        """The mean error of both critics, whose estimates have the shape (2, n)."""
        error = functional.huber_loss if self.config.huber else functional.mse_loss
        return error(values, target.expand_as(values))

    def _alpha_loss(self, model: SACAgent, log_probs: Tensor) -> Tensor:
        """Falls with the temperature where the entropy is above its target, else rises."""
        target_entropy = -model.spec.num_actions
        return model.log_alpha * (-log_probs.mean() - target_entropy)

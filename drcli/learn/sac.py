"""Soft actor-critic (Haarnoja et al., 2018b) with one convolutional body for all its networks."""

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn import functional

from drcli.learn.buffer import Rollout
from drcli.learn.encoders import Encoder
from drcli.learn.observation import Observation
from drcli.learn.ppo import EpochStats, NonFiniteLossError, UpdateInterruptedError
from drcli.learn.precision import Compute
from drcli.learn.replay import Replay, Transitions
from drcli.learn.spec import PolicySpec
from drcli.learn.squashed import squash
from drcli.learn.state import optimizer_tensors, restore_optimizer

LOG_STD_RANGE = (-20.0, 2.0)
"""Bounds of the policy's log standard deviation. Source: the reference's SAC head."""

UPDATES_PER_STEP = {"cpu": 0.5, "cuda": 1.0}
"""Gradient steps for each environment step. The reference makes 1, which on a processor takes far
longer than driving."""

REPORTS = 4
"""Into how many parts an update is divided for its reports."""

_LEAST_ALPHA = 1e-4
"""Temperature at the start when it is to find itself and `sac_alpha` is 0."""

_SUMMARY = 50
"""Values that a head keeps of the body's features. Source: DrQ (Kostrikov et al., 2020)."""

_WIDTH = 256
"""Width of the heads' hidden layers. Source: the reference's SAC heads."""


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


class SACAgent(nn.Module):
    """Everything that is learned: what drives, what judges, and how much chance is worth.

    The reference trains three bodies. Here there is one, which learns from the critics alone; the
    actor takes its features as they are, and so do the target critics, which have no body of their
    own (Yarats et al., 2021, "DrQ-v2"). A critic that sees the state does not look at the picture,
    and the body learns from the actor instead.
    """

    def __init__(self, spec: PolicySpec, sac_alpha: float = SACConfig.sac_alpha) -> None:
        """Begin with nearly uniform actions.

        Args:
            spec: Input and output; it must be continuous.
            sac_alpha: Temperature at the start.
        """
        super().__init__()
        self.spec = spec
        self.body = Encoder(spec)
        self.actor = nn.Sequential(
            _summary(self.body.features), _hidden_layers(_SUMMARY, 2 * spec.num_actions)
        )
        self.critics = _TwinCritic(spec.state_dims or self.body.features, spec.num_actions)
        self.targets = deepcopy(self.critics).requires_grad_(False)
        self.log_alpha = nn.Parameter(torch.tensor(math.log(max(sac_alpha, _LEAST_ALPHA))))
        for parameter in self.body.parameters():
            if parameter.dim() == 4:
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """The policy before tanh: mean and log standard deviation, each of shape (n, dims)."""
        mean, log_std = self.actor(features).chunk(2, dim=-1)
        return mean, log_std.clamp(*LOG_STD_RANGE)

    def features(self, seen: Observation) -> Tensor:
        """What the body makes of n observations. Shape (n, features)."""
        features: Tensor = self.body(seen)
        return features.float()

    def judged(self, features: Tensor, seen: Observation) -> Tensor:
        """What the critics look at. Shape (n, features) or (n, state_dims)."""
        return seen.state if self.spec.state_dims else features

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Choose actions in [-1, 1]; see `acting.Policy`. There is no blind share here."""
        features = self.features(seen)
        mean, log_std = self(features)
        actions, log_probs = squash(mean, log_std, noise * ~deterministic.unsqueeze(-1))
        value = self.critics(self.judged(features, seen), actions).amin(0)
        return actions, log_probs, value


class SAC:
    """The learner: an agent, its memory, its optimizer, and the update that improves it."""

    def __init__(self, model: SACAgent, config: SACConfig, compute: Compute) -> None:
        self.model = model.to(compute.device)
        self.config = config
        self.compute = compute
        self.updates_per_step = config.updates_per_step or UPDATES_PER_STEP[compute.device.type]
        self.replay = Replay(model.spec, config.replay_steps)
        learned = [p for p in model.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(learned, lr=config.lr, fused=True)

    @property
    def memory_steps(self) -> int:
        """Steps of earlier rollouts that it still learns from."""
        return self.config.replay_steps

    def remember(self, rollout: Rollout) -> None:
        """Take up a rollout of an earlier iteration without learning from it now."""
        self.replay.add(rollout)

    def optimizer_tensors(self) -> dict[str, Tensor]:
        """Everything beside the model that a checkpoint keeps; the replay is not among it."""
        return optimizer_tensors(self.optimizer)

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take up the memory of another optimizer; the replay fills anew."""
        restore_optimizer(self.optimizer, tensors)

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
            One for each part; none while too few steps are remembered.

        Raises:
            NonFiniteLossError: At the first loss, and at weights, that are NaN or infinite.
            UpdateInterruptedError: When `should_stop` said so.
        """
        self.replay.add(rollout)
        if self.replay.steps < self.config.learning_starts or not self.replay.transitions:
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
        model, device = self.model, self.compute.device
        batch = self.replay.sample(self.config.batch_size, draw).to(device)
        shape = (2, *batch.actions.shape)
        here, there = torch.randn(shape, generator=draw).to(device).unbind()
        alpha = self.alpha()

        with self.compute.autocast():
            features = model.features(batch.before)
        target = self._target(batch, there, alpha)
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
            loss = loss + self._alpha_loss(log_probs.detach())

        if not bool(torch.isfinite(loss)):
            raise NonFiniteLossError(
                f"The loss is {loss.item()} (actor {actor_loss.item():.4g}, "
                f"critics {critic_loss.item():.4g}, temperature {alpha.item():.4g})."
            )
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()

        with torch.no_grad():
            for target_p, p in zip(
                model.targets.parameters(), model.critics.parameters(), strict=True
            ):
                target_p.lerp_(p, self.config.tau)
            means = (actor_loss, critic_loss, -log_probs.mean(), alpha, values.mean())
            return torch.stack(means).cpu()

    def alpha(self) -> Tensor:
        """The temperature now; the optimizer never sees it as a part of the losses."""
        if self.config.auto_alpha:
            return self.model.log_alpha.detach().exp()
        return torch.tensor(self.config.sac_alpha, device=self.compute.device)

    def _target(self, batch: Transitions, noise: Tensor, alpha: Tensor) -> Tensor:
        """What the critics should have said: r + gamma * (min Q' - alpha * log pi). Shape (n,)."""
        model = self.model
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

    def _alpha_loss(self, log_probs: Tensor) -> Tensor:
        """Falls with the temperature where the entropy is above its target, else rises."""
        target_entropy = -self.model.spec.num_actions
        return self.model.log_alpha * (-log_probs.mean() - target_entropy)


class _TwinCritic(nn.Module):
    """Two estimates of what an action leads to, on one summary of what is seen."""

    def __init__(self, features: int, num_actions: int) -> None:
        super().__init__()
        self.summary = _summary(features)
        self.streams = nn.ModuleList(_hidden_layers(_SUMMARY + num_actions, 1) for _ in range(2))

    def forward(self, features: Tensor, actions: Tensor) -> Tensor:
        """Expected discounted return of n actions. Shape (2, n)."""
        x = torch.cat([self.summary(features), actions], dim=-1)
        return torch.stack([stream(x).squeeze(-1) for stream in self.streams])


def _summary(features: int) -> nn.Module:
    """A few values of about equal size, whatever the size of the features."""
    return nn.Sequential(nn.Linear(features, _SUMMARY), nn.LayerNorm(_SUMMARY), nn.Tanh())


def _hidden_layers(width: int, out: int) -> nn.Module:
    return nn.Sequential(
        nn.Linear(width, _WIDTH),
        nn.ReLU(inplace=True),
        nn.Linear(_WIDTH, _WIDTH),
        nn.ReLU(inplace=True),
        nn.Linear(_WIDTH, out),
    )

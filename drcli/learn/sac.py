"""Soft actor-critic (Haarnoja et al., 2018b): the update."""

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call
from torch.nn import functional

from drcli.learn.adam import Adam
from drcli.learn.advantages import gae
from drcli.learn.algorithms import UPDATES_PER_STEP, SACConfig
from drcli.learn.compute import Compute
from drcli.learn.cuda import CapturedStep
from drcli.learn.data_parallel import DataParallel, GradientGroup
from drcli.learn.learner import Learner
from drcli.learn.policy import Observation, PolicySpec
from drcli.learn.replay_buffer import ReplayBuffer, Transitions
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.sac_networks import SACAgent, squash
from drcli.learn.update_result import (
    NonFiniteLossError,
    SACStats,
    require_finite_losses,
    require_finite_weights,
)

REPORTS = 4
"""Reported parts of an update."""

NUM_STATISTICS = 8
"""Numbers in `SACStats` that are means over minibatches."""

LOSSES = ("actor", "qf1_values", "qf2_values", "qf1", "qf2")
RANK_STRIDE = 7_919
"""Separates the random numbers of processes."""


class SAC(Learner):
    """With a replay buffer. Every update begins with the critics, so none has to warm up."""

    model: SACAgent
    config: SACConfig

    def __init__(
        self,
        model: SACAgent,
        config: SACConfig,
        compute: Compute,
        group: GradientGroup | None = None,
    ) -> None:
        """Each process of a `group` keeps some of the episodes, and draws from those."""
        super().__init__(model, config, compute)
        self.memory_steps = config.sac_replay_steps
        self.updates_per_step = config.sac_updates_per_step or UPDATES_PER_STEP[compute.device.type]
        self._group = group
        self._rank, size = (0, 1) if group is None else (group.rank, group.size)
        self._given = [0] * size
        share = -(-config.sac_replay_steps // size)
        self.replay = ReplayBuffer(model.spec, share, config.discount_factor, config.sac_n_step)
        ends = [config.batch_size * rank // size for rank in (self._rank, self._rank + 1)]
        self._own_batch_size = max(1, ends[1] - ends[0])
        learned = [p for p in model.parameters() if p.requires_grad]
        self.optimizer = Adam(learned, config.lr)
        self._parallel = DataParallel(
            self.model,
            compute.parts,
            compute.threads,
            bf16=compute.bf16,
            group=group,
            num_statistics=NUM_STATISTICS,
        )
        self._fixed_alpha = torch.tensor(
            config.sac_alpha, dtype=torch.float64, device=compute.device
        )
        self._weight = 1.0
        captures = compute.graphs and group is None
        self._step = CapturedStep(self._take_step, compute.device, enabled=captures)

    @staticmethod
    def network(spec: PolicySpec, config: SACConfig) -> SACAgent:
        return SACAgent(spec, config.sac_alpha)

    def remember(self, rollout: Rollout) -> None:
        """Add a rollout of an earlier iteration without learning from it."""
        own = []
        for episode, length in enumerate(rollout.lengths.tolist()):
            rank = self._given.index(min(self._given))
            self._given[rank] += length
            if rank == self._rank:
                own.append(episode)
        self.replay.add(rollout if self._group is None else rollout.of_episodes(own))

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[SACStats], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
        steps_before: int = 0,
    ) -> list[SACStats]:
        """See `Learner.update`; any weights may have driven the rollout, and an epoch is a part."""
        self._follow_returns(rollout)
        self.remember(rollout)
        own = self.replay.transitions
        of_all = [own] if self._group is None else self._group.of_all(own)
        if sum(self._given) < self.config.sac_learning_starts or not min(of_all):
            return []
        self._weight = own / sum(of_all)
        draw = torch.Generator().manual_seed(seed + RANK_STRIDE * self._rank)
        total = max(1, round(rollout.steps * self.updates_per_step))
        parts = min(REPORTS, total)
        history = []
        self.optimizer.lr = self.lr_factor * self.config.lr
        self.model.train()
        with self._parallel.optimizer_threads():
            for part in range(parts):
                totals, count = torch.zeros(NUM_STATISTICS, device=self.compute.device), 0
                ends, all_of_part = False, total * (part + 1) // parts - total * part // parts
                while count < all_of_part and not ends:
                    batch = self.replay.sample(self._own_batch_size, draw)
                    noise = torch.randn((2, *batch.actions.shape), generator=draw)
                    totals += self._step(noise, *batch.before, *batch.after, *batch[1:3], batch[4])
                    count += 1
                    ends = should_stop()
                means = (totals / count).tolist()
                require_finite_losses(dict(zip(LOSSES, means, strict=False)))
                history.append(SACStats(part, self.optimizer.lr, *means))
                on_epoch(history[-1])
                if ends:
                    break
        require_finite_weights(self.model)
        return history

    def _take_step(self, noise: Tensor, *columns: Tensor) -> Tensor:
        before, after = Observation(*columns[:3]), Observation(*columns[3:6])
        actions, returns, discounts = columns[6:]
        batch = Transitions(before, actions, returns, after, discounts)
        loss = partial(self._loss, batch, noise)
        self.optimizer.zero_grad()
        statistics = self._parallel.backward_share(loss, len(returns), self._weight)
        self.optimizer.step()
        self._follow_critics()
        return statistics

    def _follow_returns(self, rollout: Rollout) -> None:
        nothing = np.zeros(rollout.steps)
        # With lambda 1 and values of 0, advantages are returns.
        gamma = self.config.discount_factor
        known = rollout.learned
        returns = gae(rollout.rewards, nothing, rollout.lengths, gamma, 1.0, learned=known)[known]
        if not len(returns):
            return
        if not np.isfinite(returns).all():
            raise NonFiniteLossError("A return is nan or infinite.")
        values = np.asarray(rollout.values, np.float64)[known]
        device = self.compute.device
        self.model.follow_returns(
            torch.from_numpy(returns).to(device), torch.from_numpy(values).to(device)
        )

    def _follow_critics(self) -> None:
        with torch.no_grad():
            for target, p in zip(
                self.model.targets.parameters(), self.model.critics.parameters(), strict=True
            ):
                target.lerp_(p, self.config.sac_tau)

    def _loss(
        self, batch: Transitions, noise: Tensor, model: SACAgent, part: slice
    ) -> tuple[Tensor, Tensor]:
        """`noise` of shape (2, n, dims) is for the actions before and after each step."""
        batch = batch.part(part, self.compute.device)
        noise_before, noise_after = noise[:, part].to(self.compute.device).unbind()
        alpha = self.alpha()

        features = model.features(batch.before)
        target = self._target(model, batch, noise_after, alpha)
        values = model.critics(model.critic_input(features, batch.before), batch.actions)
        critic_loss = self._critic_loss(values, target)

        # The body learns from one of the two losses only, see SACAgent.
        mean, log_std = model(features if model.spec.state_dims else features.detach())
        actions, log_probs = squash(mean, log_std, noise_before)
        seen = model.critic_input(features.detach(), batch.before)
        fixed = {name: p.detach() for name, p in model.critics.named_parameters()}
        q: Tensor = functional_call(model.critics, fixed, (seen, actions)).amin(0)
        actor_loss = (alpha * log_probs - q).mean()
        alpha_loss = self._alpha_loss(model, log_probs.detach())
        loss = critic_loss + actor_loss
        if self.config.sac_auto_alpha:
            loss = loss + alpha_loss

        if not loss.is_cuda and not bool(torch.isfinite(loss)):
            raise NonFiniteLossError(
                f"The loss is {loss.item()} (actor {actor_loss.item():.4g}, "
                f"critics {critic_loss.item():.4g}, temperature {alpha.item():.4g})."
            )
        with torch.no_grad():
            shown = alpha_loss if self.config.sac_auto_alpha else torch.full_like(alpha, torch.nan)
            each = self._critic_loss(values, target, "none").mean(1)
            qf = (*model.returns(values.mean(1)).float(), *each)
            worth = model.returns(alpha).float()
            return loss, torch.stack([actor_loss, *qf, -log_probs.mean(), worth, shown])

    def alpha(self) -> Tensor:
        if self.config.sac_auto_alpha:
            return self.model.log_alpha.detach().exp()
        return self.model.returns.units(self._fixed_alpha)

    def _target(self, model: SACAgent, batch: Transitions, noise: Tensor, alpha: Tensor) -> Tensor:
        """In the critics' units: R + gamma^k * (min Q' - alpha * log pi). Shape (n,)."""
        with torch.no_grad():
            features = model.features(batch.after)
            mean, log_std = model(features)
            actions, log_probs = squash(mean, log_std, noise)
            q: Tensor = model.targets(model.critic_input(features, batch.after), actions).amin(0)
            returns = model.returns.units(batch.returns)
            return returns + batch.discounts * (q - alpha * log_probs)

    def _critic_loss(self, values: Tensor, target: Tensor, reduction: str = "mean") -> Tensor:
        error = functional.huber_loss if self.config.huber else functional.mse_loss
        return error(values, target.expand_as(values), reduction=reduction)

    def _alpha_loss(self, model: SACAgent, log_probs: Tensor) -> Tensor:
        target_entropy = -model.spec.num_actions
        return model.log_alpha * (-log_probs.mean() - target_entropy)

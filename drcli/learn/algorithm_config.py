"""The hyperparameters of PPO and SAC, under the names of hyperparameters.json."""

from dataclasses import dataclass

SCHEDULE_END = 0.05
"""Share of a value that is left at the end of its schedule, so that training can go on."""

UPDATES_PER_STEP = {"cpu": 0.5, "cuda": 1.0}
"""Gradient steps for each environment step. The reference makes 1, which on a processor takes far
longer than driving."""


@dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO.

    Clip range, lambda and Adam's epsilon are the reference's constants unless set otherwise.

    Attributes:
        batch_size: Steps in a minibatch.
        num_epochs: Passes over a rollout.
        lr: Adam's learning rate.
        discount_factor: Weight of a reward one step later.
        beta_entropy: Weight of the entropy in the loss.
        huber: Huber loss for the value, with delta 1, instead of the squared error. The value is
            in the critic's own units; the mean size of the returns is `return_scale.UNITS`.
        clip_range: How far the probability ratio may move away from 1 before the objective is
            clipped (epsilon in the paper).
        gae_lambda: Weight of longer returns in the advantage.
        adam_eps: Added to the root of Adam's second moment.
        clip_value: How far a value may change, in the critic's own units, before its loss is
            clipped. None here and below: no limit.
        clip_advantage: Largest normalised advantage.
        target_kl: Largest mean KL divergence of an epoch from the policy that drove; the update
            ends after that epoch.
        max_grad_norm: Largest norm of a minibatch's gradient.
        lr_schedule: "linear" lets `lr` fall over `schedule_steps`.
        entropy_schedule: "linear" lets `beta_entropy` fall likewise.
        schedule_steps: Environment steps after which such a value has reached `SCHEDULE_END`.
        smoothness: Weight of the squared difference between the policy's means, or probabilities,
            in a step and in the next one (Mysore et al., 2021, "Regularizing action policies for
            smooth control"); 0 for none.
        bootstrap_cut: Add the critic's value estimate to the return of an episode that was cut
            off by the step limit; the reference adds nothing.
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
    lr_schedule: str = "constant"
    entropy_schedule: str = "constant"
    schedule_steps: int = 500_000
    smoothness: float = 0.0
    bootstrap_cut: bool = False

    def lr_at(self, steps: int) -> float:
        """The learning rate after this many environment steps."""
        return self.lr * self._left(self.lr_schedule, steps)

    def beta_entropy_at(self, steps: int) -> float:
        """The weight of the entropy after this many environment steps."""
        return self.beta_entropy * self._left(self.entropy_schedule, steps)

    def _left(self, schedule: str, steps: int) -> float:
        return max(SCHEDULE_END, 1.0 - steps / self.schedule_steps) if schedule == "linear" else 1.0


@dataclass(frozen=True)
class SACConfig:
    """Hyperparameters of SAC.

    Attributes:
        batch_size: Steps in a minibatch.
        lr: Adam's learning rate, for all networks and the temperature.
        discount_factor: Weight of a reward one step later.
        sac_alpha: Temperature: what one nat of entropy is worth in reward. If it is learned, its
            first value, in the critics' own units, as in `PPOConfig.huber`.
        sac_auto_alpha: Learn the temperature, so that the policy's entropy becomes -1 nat for each
            dimension of an action.
        huber: Huber loss for the critics, with delta 1, instead of the squared error. The values
            are in the critics' own units.
        sac_tau: How far the target critics follow the critics at each gradient step. They lag
            1 / tau steps behind; the reference copies them after every
            `num_episodes_between_training` steps, n, and lags n / 2 on average: tau = 2 / n.
        sac_n_step: Rewards that the critics' targets count before they trust a critic. The
            reference counts one, and what happens a few steps later reaches an action slowly.
        sac_updates_per_step: Gradient steps for each environment step; None: the device's default.
        sac_learning_starts: Environment steps to drive before the first gradient step.
        sac_replay_steps: Environment steps in the replay buffer.
    """

    batch_size: int = 64
    lr: float = 3e-4
    discount_factor: float = 0.999
    sac_alpha: float = 0.2
    sac_auto_alpha: bool = False
    huber: bool = False
    sac_tau: float = 0.02
    sac_n_step: int = 5
    sac_updates_per_step: float | None = None
    sac_learning_starts: int = 1_000
    sac_replay_steps: int = 100_000

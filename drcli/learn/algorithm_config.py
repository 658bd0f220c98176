"""The hyperparameters of PPO and SAC, under the names of hyperparameters.json."""

from dataclasses import dataclass

SCHEDULE_END = 0.05
"""Share of a value that is left at the end, so that training can go on."""

UPDATES_PER_STEP = {"cpu": 0.5, "cuda": 1.0}
"""The reference's 1 takes a processor far longer than driving."""


@dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO.

    Attributes:
        huber: Huber loss (delta 1) for the value, whose mean size is `return_scale.UNITS`.
        clip_value: In the critic's own units. None here and below: no limit.
        target_kl: Mean KL divergence after which no further epoch follows.
        lr_schedule: "linear" lets `lr` fall over `schedule_steps`.
        smoothness: Weight of the policy's squared change between steps (Mysore et al., 2021,
            "Regularizing action policies for smooth control").
        bootstrap_cut: Add the critic's estimate where the step limit cut an episode off.
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
        return self.lr * self._left(self.lr_schedule, steps)

    def beta_entropy_at(self, steps: int) -> float:
        return self.beta_entropy * self._left(self.entropy_schedule, steps)

    def _left(self, schedule: str, steps: int) -> float:
        return max(SCHEDULE_END, 1.0 - steps / self.schedule_steps) if schedule == "linear" else 1.0


@dataclass(frozen=True)
class SACConfig:
    """Hyperparameters of SAC.

    Attributes:
        sac_alpha: What one nat of entropy is worth; if learned, the first value, in the critics'
            units.
        sac_auto_alpha: Learn it, for -1 nat per dimension of an action.
        sac_tau: The target critics lag 1 / tau gradient steps; the reference copies them every n =
            `num_episodes_between_training` steps, and lags n / 2: tau = 2 / n.
        sac_n_step: With the reference's one, what happens a few steps later reaches an action
            slowly.
        sac_updates_per_step: None: the device's default.
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

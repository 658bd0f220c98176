"""The algorithms: what each reads of hyperparameters.json, and what it allows and needs.

A new one is a row of `ALGORITHMS` and a module with a `Learner`, which alone loads torch.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TypeVar

SCHEDULE_END = 0.05
"""Share of a value that is left at the end, so that training can go on."""

UPDATES_PER_STEP = {"cpu": 0.5, "cuda": 1.0}
"""The reference's 1 takes a processor far longer than driving."""


@dataclass(frozen=True)
class AlgorithmConfig:
    """The hyperparameters of an algorithm, under the names of hyperparameters.json."""

    batch_size: int = 64
    lr: float = 3e-4
    discount_factor: float = 0.999


@dataclass(frozen=True)
class PPOConfig(AlgorithmConfig):
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

    num_epochs: int = 10
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
class SACConfig(AlgorithmConfig):
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

    sac_alpha: float = 0.2
    sac_auto_alpha: bool = False
    huber: bool = False
    sac_tau: float = 0.02
    sac_n_step: int = 5
    sac_updates_per_step: float | None = None
    sac_learning_starts: int = 1_000
    sac_replay_steps: int = 100_000


C = TypeVar("C", bound=AlgorithmConfig)


def algorithm_config(kind: type[C], parameters: object) -> C:
    """With what `parameters` say; None stands for the algorithm's own default."""
    values = {each.name: getattr(parameters, each.name, None) for each in fields(kind)}
    return kind(**{name: value for name, value in values.items() if value is not None})


@dataclass(frozen=True)
class Algorithm:
    """An algorithm, as the rest of the program sees it.

    Attributes:
        name: `training_algorithm` of model_metadata.json.
        label: In sentences.
        words: For the form of the page.
        learner: The class of its `Learner`, as in module:class.
        also_reads: Keys of hyperparameters.json that are not in its config.
        drops: Keys of the reference that are left out of the copy which is stored with a model.
        ranges_only: It needs continuous actions.
        explores: Its usual `exploration_type`; `refuses` says why it takes no other, and
            `refuses_with_ranges` why not with continuous actions.
        entropy: The hyperparameter that makes it explore more, and its usual value.
        steers_entropy: It keeps the entropy by itself, so that a rise is no warning.
        replay: The hyperparameter with the steps that it learns from again and again; empty if it
            learns from each iteration once.
        parallel: It can learn in several processes.
        teachable: A teacher can prepare its policy.
        in_reference: The reference simulator has a policy with the same layers.
        console: Values that the console and the reference insist on; None: they do not know it.
    """

    name: str
    label: str
    words: str
    config: type[AlgorithmConfig]
    learner: str
    also_reads: frozenset[str] = frozenset()
    drops: frozenset[str] = frozenset({"sac_alpha"})
    ranges_only: bool = False
    explores: str = "categorical"
    refuses: Mapping[str, str] = field(default_factory=dict)
    refuses_with_ranges: Mapping[str, str] = field(default_factory=dict)
    entropy: tuple[str, float] = ("beta_entropy", 0.01)
    steers_entropy: bool = False
    replay: str = ""
    parallel: bool = True
    teachable: bool = False
    in_reference: bool = False
    console: Mapping[str, object] | None = None

    @property
    def keys(self) -> frozenset[str]:
        return self.also_reads | {each.name for each in fields(self.config)}

    def reads(self, key: str) -> bool:
        """Whether a hyperparameter has an effect, as far as that depends on the algorithm."""
        return key in self.keys or not any(key in each.keys for each in ALGORITHMS.values())


ALGORITHMS: dict[str, Algorithm] = {
    each.name: each
    for each in (
        Algorithm(
            "clipped_ppo",
            "PPO",
            "PPO (clipped_ppo): a list of actions or ranges",
            PPOConfig,
            "drcli.learn.ppo:PPO",
            also_reads=frozenset({"e_greedy_value", "epsilon_steps", "training_method"}),
            refuses={"additive_noise": "belongs to sac; clipped_ppo explores with categorical"},
            refuses_with_ranges={
                "e-greedy": "chooses from a list of actions; this model has ranges, which "
                "clipped_ppo explores with categorical"
            },
            teachable=True,
            in_reference=True,
            console={},
        ),
        Algorithm(
            "sac",
            "SAC",
            "SAC (sac): ranges only",
            SACConfig,
            "drcli.learn.sac:SAC",
            drops=frozenset({"beta_entropy", "num_epochs"}),
            ranges_only=True,
            explores="additive_noise",
            refuses={
                "e-greedy": "chooses from a list of actions, but sac needs ranges; use "
                "additive_noise"
            },
            entropy=("sac_alpha", 0.1),
            steers_entropy=True,
            replay="sac_replay_steps",
            console={
                "num_episodes_between_training": 1,
                "DR_WORKERS": 1,
                "exploration_type": "additive_noise",
            },
        ),
    )
}
"""By name, the default first."""


def algorithm_named(name: object) -> Algorithm:
    """The default for a name that is missing or unknown."""
    return ALGORITHMS.get(str(name), next(iter(ALGORITHMS.values())))

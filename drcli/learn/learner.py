"""What a training asks of the learner of an algorithm."""

from collections.abc import Callable, Sequence
from pkgutil import resolve_name
from typing import Any, Protocol

from drcli.learn.adam import Adam
from drcli.learn.algorithms import Algorithm, AlgorithmConfig
from drcli.learn.compute import Compute
from drcli.learn.data_parallel import GradientGroup
from drcli.learn.network import Network
from drcli.learn.policy import PolicySpec
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.update_result import Stats


class Learner(Protocol):
    """A network, its optimizer, and the update that improves the network.

    Attributes:
        lr_factor: Share of the learning rate.
        critic_warmup: Most updates that still improve a new critic alone.
    """

    lr_factor: float
    critic_warmup: int

    def __init__(
        self, model: Any, config: Any, compute: Compute, group: GradientGroup | None = None
    ) -> None:
        """`model` and `config` are of the algorithm's own classes."""

    @staticmethod
    def network(spec: PolicySpec, config: Any) -> Network:
        """A network with fresh weights."""

    @property
    def model(self) -> Network: ...

    @property
    def config(self) -> AlgorithmConfig: ...

    @property
    def compute(self) -> Compute: ...

    @property
    def optimizer(self) -> Adam: ...

    @property
    def memory_steps(self) -> int:
        """Steps of earlier iterations that it learns from; a resumed one gets them again."""

    @property
    def capture_failure(self) -> str | None:
        """Why a GPU unexpectedly gets each operation by itself."""

    @property
    def most_samples(self) -> int | None:
        """Samples that fit into the GPU's memory at once; None as long as all do."""

    def remember(self, rollout: Rollout) -> None:
        """Take a rollout of an earlier iteration, without learning from it."""

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[Any], None] = ...,
        should_stop: Callable[[], bool] = ...,
        steps_before: int = ...,
    ) -> Sequence[Stats]:
        """Improve the policy on one iteration of driving.

        Args:
            rollout: Driven with the present weights, if `memory_steps` is 0.
            seed: Decides the order of the minibatches.
            on_epoch: Called with the statistics of each epoch.
            should_stop: Asked after each minibatch; ends the update early, which is sound.
            steps_before: Environment steps so far, for the schedules.

        Raises:
            NonFiniteLossError: A return, a loss or a weight is NaN or infinite.
            LearnerLostError: Another process of the group has ended.
        """


def learner_of(algorithm: Algorithm) -> type[Learner]:
    found: type[Learner] = resolve_name(algorithm.learner)
    return found

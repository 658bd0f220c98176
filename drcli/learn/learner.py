"""What a training asks of the learner of an algorithm."""

from collections.abc import Callable, Sequence
from pkgutil import resolve_name
from typing import Any

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.adam import Adam
from drcli.learn.algorithms import Algorithm, AlgorithmConfig
from drcli.learn.compute import Compute
from drcli.learn.cuda import CapturedStep
from drcli.learn.data_parallel import DataParallel, GradientGroup
from drcli.learn.encoders import Network
from drcli.learn.policy import PolicySpec
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.update_result import Stats


class Learner:
    """A network, its optimizer, and the update that improves the network.

    Attributes:
        lr_factor: Share of the learning rate.
        critic_warmup: Most updates that still improve a new critic alone: one that guesses would
            change the shared body, and a policy would forget.
        memory_steps: Steps of earlier iterations that it learns from; a resumed one gets them
            again.
    """

    lr_factor = 1.0
    critic_warmup = 0
    memory_steps = 0
    optimizer: Adam
    _parallel: DataParallel[Any]
    _step: CapturedStep

    def __init__(
        self, model: Any, config: Any, compute: Compute, group: GradientGroup | None = None
    ) -> None:
        """`model` and `config` are of the algorithm's own classes."""
        self.model: Network = model.to(compute.device)
        self.config: AlgorithmConfig = config
        self.compute = compute

    @staticmethod
    def network(spec: PolicySpec, config: Any) -> Network:
        """With fresh weights."""
        return ActorCritic(spec)

    @property
    def capture_failure(self) -> str | None:
        """Why a GPU unexpectedly gets each operation by itself."""
        return self._step.failure

    @property
    def most_samples(self) -> int | None:
        """Samples that fit into the GPU's memory at once; None as long as all do."""
        return self._parallel.most_samples

    def remember(self, rollout: Rollout) -> None:
        """Take a rollout of an earlier iteration, without learning from it."""

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[Any], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
        steps_before: int = 0,
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
        raise NotImplementedError


def learner_of(algorithm: Algorithm) -> type[Learner]:
    found: type[Learner] = resolve_name(algorithm.learner)
    return found

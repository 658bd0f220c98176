"""The network and the learner's knobs, from the run's parameter files."""

from collections.abc import Callable, Sequence
from typing import Protocol

from torch import Tensor, nn

from drcli.learn.network_spec import PolicySpec
from drcli.learn.policy import ActorCritic
from drcli.learn.ppo import PPO, EpochStats, PPOConfig
from drcli.learn.precision import Compute
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.sac import SAC, SACConfig
from drcli.learn.sac_networks import SACAgent
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata

STATE_DIMS = 22
"""Length of `Simulation.privileged`. Told here once more, because a trainer that loaded the
simulator for it would need 33 MB more memory."""


def policy_spec(metadata: ModelMetadata, parameters: Hyperparameters) -> PolicySpec:
    """The network that model_metadata.json and hyperparameters.json ask for."""
    space = metadata.action_space
    return PolicySpec(
        num_actions=space.num_actions,
        continuous=space.continuous,
        network=metadata.neural_network,
        eyes=metadata.eyes,
        stack=parameters.stack_size,
        scan_dims=metadata.scan_dims,
        state_dims=STATE_DIMS if parameters.critic == "state" else 0,
    )


def build_policy(metadata: ModelMetadata, parameters: Hyperparameters) -> ActorCritic | SACAgent:
    """A network to drive with, its weights still to come."""
    spec = policy_spec(metadata, parameters)
    model = SACAgent(spec) if metadata.training_algorithm == "sac" else ActorCritic(spec)
    return model.eval()


class Learner(Protocol):
    """What the trainer needs of an algorithm."""

    @property
    def model(self) -> nn.Module:
        """All weights; checkpoints hold them."""

    @property
    def memory_steps(self) -> int:
        """Steps of earlier rollouts that it still learns from."""

    def remember(self, rollout: Rollout) -> None:
        """Take up a rollout of an earlier iteration without learning from it now."""

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[EpochStats], None] = ...,
        should_stop: Callable[[], bool] = ...,
        steps_before: int = ...,
    ) -> Sequence[EpochStats]:
        """Improve the policy; see `PPO.update`."""

    def optimizer_tensors(self) -> dict[str, Tensor]:
        """The optimizer's memory, to go on with."""

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take up the memory of another optimizer.

        Raises:
            ValueError: It belongs to another network; nothing was taken up.
        """


def build_learner(
    metadata: ModelMetadata, parameters: Hyperparameters, compute: Compute
) -> Learner:
    """The algorithm that model_metadata.json asks for, with fresh weights."""
    spec = policy_spec(metadata, parameters)
    if metadata.training_algorithm == "sac":
        return SAC(SACAgent(spec, parameters.sac_alpha), sac_config(parameters), compute)
    return PPO(ActorCritic(spec), ppo_config(parameters), compute)


def sac_config(parameters: Hyperparameters) -> SACConfig:
    """SAC's knobs from hyperparameters.json; those left out are the learner's own."""
    p = parameters
    return SACConfig(
        batch_size=p.batch_size,
        lr=p.lr,
        discount_factor=p.discount_factor,
        sac_alpha=p.sac_alpha,
        auto_alpha=p.sac_auto_alpha,
        huber=p.huber,
        tau=SACConfig.tau if p.sac_tau is None else p.sac_tau,
        updates_per_step=p.sac_updates_per_step,
        learning_starts=p.sac_learning_starts,
        replay_steps=p.sac_replay_steps,
    )


def ppo_config(parameters: Hyperparameters) -> PPOConfig:
    """The learner's knobs from hyperparameters.json."""
    p = parameters
    return PPOConfig(
        batch_size=p.batch_size,
        num_epochs=p.num_epochs,
        lr=p.lr,
        discount_factor=p.discount_factor,
        beta_entropy=p.beta_entropy,
        huber=p.huber,
        clip_range=p.clip_range,
        gae_lambda=p.gae_lambda,
        clip_value=p.clip_value,
        clip_advantage=p.clip_advantage,
        target_kl=p.target_kl,
        max_grad_norm=p.max_grad_norm,
        lr_linear=p.lr_schedule == "linear",
        entropy_linear=p.entropy_schedule == "linear",
        schedule_steps=p.schedule_steps,
        bootstrap_cut=p.bootstrap_cut,
    )

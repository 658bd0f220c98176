"""Builds network and learner from model_metadata.json and hyperparameters.json."""

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithm_config import PPOConfig, SACConfig
from drcli.learn.compute import Compute
from drcli.learn.policy import PolicySpec
from drcli.learn.ppo import PPO
from drcli.learn.sac import SAC
from drcli.learn.sac_networks import SACAgent
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata

Learner = PPO | SAC

STATE_DIMS = 22
"""Length of `Simulation.privileged`. It is repeated here because a trainer that loaded the
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
    """A network to drive with; its weights come from a checkpoint."""
    spec = policy_spec(metadata, parameters)
    model = SACAgent(spec) if metadata.training_algorithm == "sac" else ActorCritic(spec)
    return model.eval()


def build_learner(
    metadata: ModelMetadata, parameters: Hyperparameters, compute: Compute
) -> Learner:
    """The algorithm that model_metadata.json asks for, with fresh weights."""
    spec = policy_spec(metadata, parameters)
    if metadata.training_algorithm == "sac":
        return SAC(SACAgent(spec, parameters.sac_alpha), sac_config(parameters), compute)
    return PPO(ActorCritic(spec), ppo_config(parameters), compute)


def sac_config(parameters: Hyperparameters) -> SACConfig:
    """SAC's hyperparameters; those left out are the learner's defaults."""
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
    """PPO's hyperparameters."""
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

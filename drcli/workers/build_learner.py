"""Builds network and learner from model_metadata.json and hyperparameters.json."""

from dataclasses import fields
from typing import TypeVar

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
C = TypeVar("C", PPOConfig, SACConfig)

STATE_DIMS = 22
"""Length of `Simulation.privileged`. It is repeated here because loading the simulator for it would
cost the trainer 33 MB of memory."""


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
    """A network to drive with, which gets its weights from a checkpoint."""
    spec = policy_spec(metadata, parameters)
    model = SACAgent(spec) if metadata.training_algorithm == "sac" else ActorCritic(spec)
    return model.eval()


def build_learner(
    metadata: ModelMetadata, parameters: Hyperparameters, compute: Compute
) -> Learner:
    """The algorithm that model_metadata.json asks for, with fresh weights."""
    spec = policy_spec(metadata, parameters)
    if metadata.training_algorithm == "sac":
        return SAC(
            SACAgent(spec, parameters.sac_alpha), algorithm_config(SACConfig, parameters), compute
        )
    return PPO(ActorCritic(spec), algorithm_config(PPOConfig, parameters), compute)


def algorithm_config(kind: type[C], parameters: Hyperparameters) -> C:
    """The hyperparameters of an algorithm; those that are not set keep the algorithm's defaults."""
    values = {field.name: getattr(parameters, field.name, None) for field in fields(kind)}
    return kind(**{name: value for name, value in values.items() if value is not None})

"""Builds the learner from model_metadata.json and hyperparameters.json."""

from dataclasses import fields
from typing import TypeVar

from drcli.formats.build_network import policy_spec
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithm_config import PPOConfig, SACConfig
from drcli.learn.compute import Compute
from drcli.learn.ppo import PPO
from drcli.learn.sac import SAC
from drcli.learn.sac_networks import SACAgent
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata

Learner = PPO | SAC
C = TypeVar("C", PPOConfig, SACConfig)


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

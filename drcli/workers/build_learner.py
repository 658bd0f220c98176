"""Builds the learner from model_metadata.json and hyperparameters.json."""

from dataclasses import fields
from typing import TypeVar

from drcli.base.log import get_logger, plain
from drcli.config.run_config import TrainConfig
from drcli.exchange.rollback_record import Rollbacks
from drcli.formats.build_network import policy_spec
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithm_config import PPOConfig, SACConfig
from drcli.learn.compute import Compute, choose_compute
from drcli.learn.ppo import PPO
from drcli.learn.sac import SAC
from drcli.learn.sac_networks import SACAgent
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.workers.cores import learning_threads

_logger = get_logger(__name__)

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


def learner_of_training(
    train: TrainConfig,
    metadata: ModelMetadata,
    parameters: Hyperparameters,
    rollbacks: Rollbacks,
    number_format: str | None,
) -> Learner:
    """The same for a training, on the processor and with the learning rate that it has now.

    A training keeps the number format that it began with; None if it begins.
    """
    plain.info("Using the following hyper-parameters")
    plain.info(parameters.canonical_json(metadata.training_algorithm))
    compute = choose_compute(
        train.torch_precision, parameters.batch_size, learning_threads(train), before=number_format
    )
    _logger.info("Learning in %s", compute.reason)
    learner = build_learner(metadata, parameters, compute)
    learner.lr_factor = rollbacks.factor(learner.config.lr)
    if learner.lr_factor != 1.0:
        rate = learner.lr_factor * learner.config.lr
        times = "1 rollback" if rollbacks.count == 1 else "the rollbacks"
        _logger.info("The learning rate is %.3g since %s.", rate, times)
    return learner


def algorithm_config(kind: type[C], parameters: Hyperparameters) -> C:
    """The hyperparameters of an algorithm; those that are not set keep the algorithm's defaults."""
    values = {field.name: getattr(parameters, field.name, None) for field in fields(kind)}
    return kind(**{name: value for name, value in values.items() if value is not None})

"""The network and the learner's knobs, from the run's parameter files."""

from drcli.hyperparameters import Hyperparameters
from drcli.learn.policy import PolicySpec
from drcli.learn.ppo import PPOConfig
from drcli.model_metadata import ModelMetadata


def policy_spec(metadata: ModelMetadata) -> PolicySpec:
    """The network that model_metadata.json asks for."""
    space = metadata.action_space
    return PolicySpec(space.num_actions, space.continuous, metadata.neural_network)


def ppo_config(parameters: Hyperparameters) -> PPOConfig:
    """The learner's knobs from hyperparameters.json."""
    return PPOConfig(
        batch_size=parameters.batch_size,
        num_epochs=parameters.num_epochs,
        lr=parameters.lr,
        discount_factor=parameters.discount_factor,
        beta_entropy=parameters.beta_entropy,
        huber=parameters.loss_type == "huber",
    )

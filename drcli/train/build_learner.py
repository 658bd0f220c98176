"""Builds the learner from model_metadata.json and hyperparameters.json."""

from drcli.base.log import get_logger, plain
from drcli.config.run_config import TrainConfig
from drcli.convert.build_network import policy_spec
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig, algorithm_config
from drcli.learn.compute import Compute, choose_compute
from drcli.learn.data_parallel import GradientGroup
from drcli.learn.learner import Learner, learner_of
from drcli.learn.taught import TaughtLearner
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.training_state import Rollbacks
from drcli.train.learner_group import Build, LearnerGroup
from drcli.workers.cores import learning_threads

_logger = get_logger(__name__)


def build_learner(
    metadata: ModelMetadata,
    parameters: Hyperparameters,
    compute: Compute,
    group: GradientGroup | None = None,
) -> Learner:
    spec = policy_spec(metadata, parameters)
    if parameters.taught:
        config = algorithm_config(PPOConfig, parameters)
        return TaughtLearner(ActorCritic(spec), config, compute)
    algorithm = metadata.algorithm
    learner, own = learner_of(algorithm), algorithm_config(algorithm.config, parameters)
    return learner(learner.network(spec, own), own, compute, group)


def learner_of_training(
    train: TrainConfig,
    metadata: ModelMetadata,
    parameters: Hyperparameters,
    rollbacks: Rollbacks,
    number_format: str | None,
    group: LearnerGroup | None = None,
) -> Learner:
    """`number_format` is that with which the training began.

    The processes of a `group` build the same learner and share the cores.
    """
    plain.info("Using the following hyper-parameters")
    plain.info(parameters.canonical_json(metadata.training_algorithm))
    size = 1 if group is None else group.size
    compute = choose_compute(
        train.torch_precision,
        max(1, parameters.batch_size // size),
        max(1, learning_threads(train) // size),
        before=number_format,
    )
    where = f" in each of {size} processes" if size > 1 else ""
    _logger.info("Learning%s in %s", where, compute.reason)
    if compute.warning:
        _logger.warning("%s", compute.warning)
    gradients = None
    if group is not None:
        group.tell(Build(metadata, parameters, compute))
        gradients = group.gradients
    learner = build_learner(metadata, parameters, compute, gradients)
    learner.lr_factor = rollbacks.factor(learner.config.lr)
    if learner.lr_factor != 1.0:
        rate = learner.lr_factor * learner.config.lr
        times = "1 rollback" if rollbacks.count == 1 else "the rollbacks"
        _logger.info("The learning rate is %.3g since %s.", rate, times)
    return learner

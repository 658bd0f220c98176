"""Restores a trainer from a checkpoint: weights, optimizer, invalid results."""

from safetensors.torch import load as load_tensors

from drcli.base.log import get_logger
from drcli.formats.build_network import has_own_critic, load_weights
from drcli.formats.imported_policy import CRITIC_WARMUP
from drcli.learn.learner import Learner
from drcli.learn.taught import TaughtLearner
from drcli.store import keys
from drcli.store.best_checkpoint import evaluated_numbers
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import Checkpoint, checkpoint_objects

_logger = get_logger(__name__)


def restore_learner(learner: Learner, found: Checkpoint) -> None:
    """With the progress of a new critic."""
    load_weights(learner.model, found.tensors, found.record.name)
    if found.optimizer is None:
        _logger.warning("The optimizer starts over: the checkpoint has no state of it.")
    else:
        restore_optimizer(learner, found.optimizer)
    learner.critic_warmup = found.record.counters.critic_warmup or 0
    if has_own_critic(learner.model, found.tensors) and not isinstance(learner, TaughtLearner):
        learner.critic_warmup = CRITIC_WARMUP


def restore_optimizer(learner: Learner, state: bytes) -> None:
    """A safetensors file, if it fits; weights can do without it."""
    try:
        learner.optimizer.restore(load_tensors(state))
    except ValueError as error:
        _logger.warning("The optimizer starts over: its saved state does not fit: %s", error)


def forget_evaluations(bucket: Bucket, prefix: str, *, newest: int) -> None:
    """Delete results of checkpoints that do not exist, as seen from the newest.

    Later ones would count for new checkpoints of their numbers.
    """
    known = {name.number for name in checkpoint_objects(bucket, prefix).values()}
    numbers = [n for n in evaluated_numbers(bucket, prefix) if n > newest or n not in known]
    if numbers:
        bucket.delete([keys.evaluation_result(prefix, number) for number in numbers])

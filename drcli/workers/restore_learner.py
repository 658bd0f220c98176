"""Restores a trainer from a checkpoint: optimizer, and results that no longer count."""

from safetensors.torch import load as load_tensors

from drcli.base.log import get_logger
from drcli.store import keys
from drcli.store.best_checkpoint import evaluated_numbers
from drcli.store.bucket import Bucket
from drcli.workers.build_learner import Learner

_logger = get_logger(__name__)


def restore_optimizer(learner: Learner, state: bytes) -> None:
    """Load an optimizer state, a safetensors file, if it fits; weights can do without it."""
    try:
        learner.optimizer.restore(load_tensors(state))
    except ValueError as error:
        _logger.warning("The optimizer starts over: its saved state does not fit: %s", error)


def forget_evaluations(bucket: Bucket, prefix: str, *, after: int) -> None:
    """Delete the results of checkpoints after this number, because new ones get their numbers."""
    numbers = [number for number in evaluated_numbers(bucket, prefix) if number > after]
    if numbers:
        bucket.delete([keys.evaluation_result(prefix, number) for number in numbers])

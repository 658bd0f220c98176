"""Restores a trainer from a checkpoint: weights, optimizer, and results that no longer count."""

from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from torch import nn

from drcli.base.errors import SettingsError
from drcli.base.log import get_logger
from drcli.store import keys
from drcli.store.best_checkpoint import evaluated_numbers
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import Checkpoint
from drcli.workers.build_learner import Learner

_logger = get_logger(__name__)


def load_weights(model: nn.Module, found: Checkpoint) -> None:
    """Load the weights of a checkpoint into a network.

    Raises:
        SettingsError: The parameter files describe another network.
    """
    try:
        model.load_state_dict(load_tensors(found.tensors))
    except (RuntimeError, SafetensorError) as error:
        what = str(error).strip().splitlines()[-1].strip()
        raise SettingsError(
            f"The weights of {found.record.name} do not fit model_metadata.json and "
            f"hyperparameters.json: {what}",
            remedy="Restore the files that the model was trained with, or train it again with "
            "`dr-start-training -w`.",
        ) from None


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

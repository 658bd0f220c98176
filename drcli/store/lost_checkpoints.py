"""Tells a model whose checkpoints are all lost from one that was never trained.

Beginning again at iteration 0 would overwrite the rest of it.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from drcli.config.run_env import raised
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import CheckpointsLost, CheckpointStore
from drcli.store.model_prefix import is_used
from drcli.store.reconstruct import (
    reconstruct_history,
    reconstruct_record,
    traced_iterations,
    whole_checkpoints,
)

_PREFIX = "DR_LOCAL_S3_MODEL_PREFIX"


@dataclass(frozen=True)
class Lost:
    """What a model without a readable checkpoint has lost, and what is left of it.

    Attributes:
        trained: Iterations.
        checkpoints: Like the next two, a number with first and last.
        beside: An unused prefix.
    """

    model: str
    trained: int
    checkpoints: str
    curve: str
    traces: str
    files: int
    beside: str

    def refusal(self, *also: str, set_in_environment: bool = False) -> CheckpointsLost:
        """The error, with the command that starts over."""
        values = " ".join((f"{_PREFIX}={self.beside}", *also))
        command = f"dr-config set {values} && dr-start-training"
        if set_in_environment:
            command = f"{values} dr-start-training"
        return CheckpointsLost(
            f"{self.model} was trained for {self.trained} iterations, but has no checkpoint that "
            f"can be read. Lost: {self.checkpoints}. Left: the learning curve of {self.curve}, "
            f"traces of {self.traces}, {self.files} files with content in all. Nothing was "
            "changed.",
            remedy="Restore a checkpoint from a copy, or start over beside it, which deletes "
            f"nothing: `{command}`.",
        )


def find_lost(bucket: Bucket, prefix: str) -> Lost | None:
    """None if a checkpoint can be read or reconstructed, or none was published.

    The reference's count as readable. Nothing is changed.
    """
    listed = {info.key: info.size_bytes for info in bucket.list(keys.folder(prefix))}
    if not any(_tells_of_training(prefix, key) for key in listed):
        return None
    store = CheckpointStore(bucket, prefix)
    try:
        found = store.load_latest() is not None
    except CheckpointsLost:
        found = False
    if found or any(map(keys.is_tensorflow_part, listed)):
        return None
    history = reconstruct_history(bucket, prefix)
    for name in whole_checkpoints(bucket, prefix):
        if reconstruct_record(bucket, prefix, name, history) is not None:
            return None
    names = {keys.checkpoint_of(prefix, key) for key in listed} | {store.pointed()}
    numbers = sorted({name.number for name in names if name is not None})
    traced = traced_iterations(bucket, prefix).items()
    traces = [n for n, own in traced if all(listed[key] for key in own.values())]
    trained = max([-1, *traces, *(r.iteration for r in history), *(n - 1 for n in numbers)]) + 1
    return Lost(
        f"s3://{bucket.name}/{prefix}",
        trained,
        _counted(numbers, "checkpoint"),
        _counted([r.iteration for r in history], "iteration"),
        _counted(traces, "iteration"),
        sum(size > 0 for size in listed.values()),
        _free_name(bucket, prefix),
    )


def refuse_lost(bucket: Bucket, prefix: str) -> None:
    """Raise CheckpointsLost if a training must not begin here."""
    lost = find_lost(bucket, prefix)
    if lost is not None:
        raise lost.refusal()


def _tells_of_training(prefix: str, key: str) -> bool:
    name = key.removeprefix(keys.folder(prefix))
    history = keys.history(prefix)
    return (
        key in (keys.coach_checkpoint(prefix), history)
        or keys.part_number(history, key) is not None
        or re.fullmatch(r"(\d+/)?training-simtrace/\d+-iteration\.csv", name) is not None
    )


def _free_name(bucket: Bucket, prefix: str) -> str:
    name = raised(prefix, prefix)[1]
    while is_used(bucket, name):
        name = raised(name, name)[1]
    return name


def _counted(numbers: Sequence[int], what: str) -> str:
    if not numbers:
        return f"no {what}"
    if len(numbers) == 1:
        return f"1 {what} ({numbers[0]})"
    return f"{len(numbers)} {what}s ({numbers[0]} to {numbers[-1]})"

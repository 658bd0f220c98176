"""Checks and repairs a model's small objects before a command relies on them."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drcli.base import errors
from drcli.base.errors import SettingsError
from drcli.bucket.bucket import ObjectDamaged
from drcli.config.editing import raised
from drcli.config.run_config import ModelConfig
from drcli.model import keys, lease
from drcli.model.checkpoints import CheckpointsLost, CheckpointStore
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.model_prefix import is_used, model_kind
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import (
    readable_records,
    reconstruct_history,
    reconstruct_record,
    traced_iterations,
    whole_checkpoints,
)
from drcli.model.repair import find_damage, repair, set_aside
from drcli.model.run_metadata import read_start
from drcli.records.training_record import TrainingStart

_SEED = re.compile(rb'"seed": ?(\d{1,15})\b')


def repair_or_warn(
    config: ModelConfig,
    store: ModelStore,
    *,
    may_write: bool = True,
    missing: bool = False,
) -> None:
    """Repairs only while nobody trains; `missing`: a pointer to no checkpoint counts."""
    model = ModelStore.of(config, store.bucket, store.prefix)
    may_repair = may_write and lease.live_holder(store) is None
    sentences = repair_all(model, missing=missing) if may_repair else find_damage(model)
    for sentence in sentences:
        errors.warn(sentence)


def repair_all(model: ModelStore, *, missing: bool = True) -> list[str]:
    """Set damage aside and reconstruct it, with a sentence each; only while nobody trains.

    Not in a model of the reference, whose checkpoints do not help.
    """
    if model_kind(model) == "tensorflow":
        return []
    return [*repair(model, missing=missing), *_restore_parameters(model), *_repair_start(model)]


def _restore_parameters(model: ModelStore) -> list[str]:
    """From a checkpoint, which has copies; only for the owner."""
    checks: list[tuple[str, str, Callable[[bytes, str], object]]] = [
        (
            keys.hyperparameters(model.prefix),
            keys.HYPERPARAMETERS_FILE,
            Hyperparameters.from_bytes,
        ),
        (keys.model_metadata(model.prefix), keys.MODEL_METADATA_FILE, ModelMetadata.from_bytes),
    ]
    sentences = []
    for key, name, check in checks:
        damaged = model.bucket.get(key) if model.bucket.exists(key) else None
        reason = f"{model.bucket.name}/{key} is missing."
        if damaged is not None:
            try:
                check(damaged, f"{model.bucket.name}/{key}")
                continue
            except SettingsError as error:
                reason = str(error)
        records = reversed(readable_records(model))
        saved = next((r.counters.inputs[name] for r in records if name in r.counters.inputs), "")
        try:
            check(saved.encode(), name)
        except SettingsError:
            continue  # the command that needs the file says what is wrong with it
        kept = set_aside(model, key) if damaged is not None else None
        model.bucket.put(key, saved.encode())
        also = f" The damaged one is kept as {model.bucket.name}/{kept}." if kept else ""
        sentences.append(f"{reason} It was restored from a checkpoint.{also}")
    return sentences


def _repair_start(model: ModelStore) -> list[str]:
    """Keep at least the seed: resuming needs it."""
    bucket, key = model.bucket, keys.training_start(model.prefix)
    store = ModelStore(bucket, model.prefix)
    try:
        read_start(store)
    except ObjectDamaged as error:
        found = _SEED.search(bucket.get(key))
        seeds = [record.counters.seed for record in readable_records(store)]
        seed = next((s for s in reversed(seeds) if s is not None), int(found[1]) if found else None)
        kept = set_aside(store, key)
        became = "Its seed is lost; the training continues with a new one."
        if seed is not None:
            bucket.put(key, TrainingStart(seed).encode())
            became = f"Its seed, {seed}, was restored."
        return [f"{error} {became} The damaged one is kept as {bucket.name}/{kept}."]
    return []


# Tells a model whose checkpoints are all lost from one that was never trained.
#
# Beginning again at iteration 0 would overwrite the rest of it.


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


def find_lost(model: ModelStore) -> Lost | None:
    """None if a checkpoint can be read or reconstructed, or none was published.

    The reference's count as readable. Nothing is changed.
    """
    listed = {info.key: info.size_bytes for info in model.bucket.list(keys.folder(model.prefix))}
    if not any(_tells_of_training(model.prefix, key) for key in listed):
        return None
    store = CheckpointStore(model)
    try:
        found = store.load_latest() is not None
    except CheckpointsLost:
        found = False
    if found or any(map(keys.is_tensorflow_part, listed)):
        return None
    history = reconstruct_history(model)
    for name in whole_checkpoints(model):
        if reconstruct_record(model, name, history) is not None:
            return None
    names = {keys.checkpoint_of(model.prefix, key) for key in listed} | {store.pointed()}
    numbers = sorted({name.number for name in names if name is not None})
    traced = traced_iterations(model).items()
    traces = [n for n, own in traced if all(listed[key] for key in own.values())]
    trained = max([-1, *traces, *(r.iteration for r in history), *(n - 1 for n in numbers)]) + 1
    return Lost(
        model.url,
        trained,
        _counted(numbers, "checkpoint"),
        _counted([r.iteration for r in history], "iteration"),
        _counted(traces, "iteration"),
        sum(size > 0 for size in listed.values()),
        _free_name(model),
    )


def refuse_lost(model: ModelStore) -> None:
    """Raise CheckpointsLost if a training must not begin here."""
    lost = find_lost(model)
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


def _free_name(model: ModelStore) -> str:
    name = raised(model.prefix, model.prefix)[1]
    while is_used(ModelStore(model.bucket, name)):
        name = raised(name, name)[1]
    return name


def _counted(numbers: Sequence[int], what: str) -> str:
    if not numbers:
        return f"no {what}"
    if len(numbers) == 1:
        return f"1 {what} ({numbers[0]})"
    return f"{len(numbers)} {what}s ({numbers[0]} to {numbers[-1]})"

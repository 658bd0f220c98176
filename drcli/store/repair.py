"""Finds damaged objects of a model, sets them aside and reconstructs them.

A full disk, an interrupted copy or an editor can damage an object. It is kept under
`runs/<prefix>/damaged/`. Only a process that may write to the model repairs it: the trainer, or a
command while no training runs; others only report what `find_damage` returns.
"""

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import accumulate

from drcli.base.json_record import NewerFormat, RecordError
from drcli.config.bucket_config import ModelConfig
from drcli.exchange.checkpoint import (
    CheckpointRecord,
    checkpoint_name,
    decode_pointer,
)
from drcli.exchange.episode_metrics import EpisodeMetrics, decode_metrics, encode_metrics
from drcli.exchange.iteration import IterationRecord, decode_history
from drcli.exchange.milestone_record import Milestones
from drcli.exchange.run_outcome import RunOutcome
from drcli.exchange.run_state import ActivityRecord, Lease
from drcli.exchange.scores import EvaluationResult, Scores
from drcli.store import keys
from drcli.store.best_checkpoint import evaluated_numbers, read_scores, write_scores
from drcli.store.bucket import (
    Bucket,
    ObjectDamaged,
    ObjectMissing,
    ObjectNewer,
    read_record,
)
from drcli.store.complete_files import combined_metrics
from drcli.store.growing_file import list_parts, read_parts
from drcli.store.history import HistoryReader, read_history, write_history
from drcli.store.milestones import write_milestones
from drcli.store.reconstruct import (
    readable_objects,
    reconstruct_history,
    reconstruct_metrics,
    reconstruct_milestones,
    reconstruct_record,
    reconstruct_scores,
    traced_iterations,
    whole_checkpoints,
)
from drcli.store.remedies import remedy_of
from drcli.store.training_records import at_once

AGAIN_S = 0.03
"""Pause before what looks damaged is read again."""

_REWRITTEN = "It will be rewritten when the training continues."

KEPT_DAMAGED, KEPT_BYTES = 100, 256 << 20
"""How many damaged objects of a model are kept, and the largest size of the older ones."""


@dataclass(frozen=True)
class Model:
    """A model whose objects are checked and repaired.

    Attributes:
        metric: DR_TRAIN_BEST_MODEL_METRIC.
        workers: The simulation workers whose metrics are checked.
    """

    bucket: Bucket
    prefix: str
    metrics_prefix: str
    metric: str = "progress"
    workers: Sequence[int] = (0,)

    @staticmethod
    def of(config: ModelConfig, bucket: Bucket, prefix: str) -> "Model":
        """A model in the bucket, which may be the model of the settings or another one."""
        if prefix == config.prefix:
            workers = range(config.workers)
            return Model(bucket, prefix, config.metrics_prefix, config.metric, workers)
        return Model(bucket, prefix, keys.metrics_prefix(prefix), config.metric)


def find_damage(model: Model) -> list[str]:
    """What is wrong with each damaged object, and what to do about it; nothing is changed."""
    found = (_told(model.bucket, item) for item in _objects(model, missing=False))
    return [text for text in found if text]


def find_small_damage(model: Model, listed: Collection[str]) -> list[str]:
    """The same for the objects that are small and have a fixed name, and for checkpoints' records.

    `listed` are keys of the bucket, those of the model among them: no more are asked for.
    """
    own = {keys.checkpoint_of(model.prefix, key) for key in listed} - {None}
    items = _small(model, [str(name) for name in own], missing=False)
    there = [item for item in items if item.key in listed]
    return sorted(text for text in at_once(partial(_told, model.bucket), there) if text)


def _told(bucket: Bucket, item: "_Object") -> str:
    """What is wrong with an object and what to do about it; empty if nothing is.

    It may be overwritten at the moment, so what looks damaged is read again, as by `read_record`.
    """
    if _damage(bucket, item) is None:
        return ""
    time.sleep(AGAIN_S)
    damage = _damage(bucket, item)
    return "" if damage is None else f"{damage.sentence} {remedy_of(item.key)}"


def repair(model: Model, *, missing: bool = True) -> list[str]:
    """Set damaged objects aside and reconstruct them, and those that are missing.

    An object may be missing because the embedded server deletes an old object a moment before it
    gives the new one its name. If it is killed just then, no client can write the object again.

    Args:
        model: Which.
        missing: Whether a pointer to a checkpoint that does not exist counts as damaged.

    Returns:
        A text for each damaged object: what was wrong, and what was done.

    Raises:
        ObjectNewer: Something is damaged, but other records are newer than this version of drcli
            can read. Nothing is changed.
    """
    done = _repaired(model, _objects(model, missing=missing))
    with suppress(ObjectNewer):  # then what is missing may be in an object that cannot be read
        done += _refilled(model)
        done += _refilled_metrics(model)
    return done


def repair_metrics(model: Model) -> list[str]:
    """Repair only the metrics of the workers, which each worker writes itself."""
    return [*_repaired(model, _metrics(model)), *_refilled_metrics(model)]


def readable_history(
    model: Model, reader: HistoryReader | None = None
) -> tuple[list[IterationRecord], list[str]]:
    """The learning curve for a reader that writes nothing, and a sentence if it is damaged.

    A `reader` remembers what it has read before.
    """
    reader = reader or HistoryReader()
    try:
        return reader.read(model.bucket, model.prefix), []
    except ObjectDamaged as error:
        return reconstruct_history(model.bucket, model.prefix), [f"{error} {error.remedy}"]


def readable_scores(model: Model) -> tuple[Scores | None, list[str]]:
    """The scores for a reader that writes nothing, and a sentence if they are damaged."""
    try:
        return read_scores(model.bucket, model.prefix), []
    except ObjectDamaged as error:
        said = f"{error} {error.remedy}"
        return reconstruct_scores(model.bucket, model.prefix, model.metric), [said]


def read_metrics(bucket: Bucket, key: str) -> list[EpisodeMetrics]:
    """The records of a worker's TrainingMetrics.json; ObjectMissing or ObjectDamaged."""
    return read_record(bucket, key, decode_metrics, remedy_of(key))


def read_all_metrics(bucket: Bucket, key: str) -> list[EpisodeMetrics]:
    """The records of a worker's TrainingMetrics.json and its parts; ObjectDamaged."""
    parts = read_parts(bucket, key, partial(read_metrics, bucket))
    try:
        return combined_metrics(read_metrics(bucket, key), parts)
    except ObjectMissing:
        return combined_metrics([], parts)


def set_aside(bucket: Bucket, prefix: str, key: str, data: bytes | None = None) -> str:
    """Move a damaged object, or its bytes if they are given, out of the model.

    Of those that were moved before, the newest stay, at most `KEPT_DAMAGED` and `KEPT_BYTES`.

    Returns:
        Its new key.
    """
    kept = keys.damaged(prefix, key, time.strftime("%Y%m%d%H%M%S", time.gmtime()))
    with suppress(ObjectMissing):
        bucket.put(kept, bucket.get(key) if data is None else data)
    older = [i for i in bucket.list(keys.damaged_folder(prefix)) if i.key != kept]
    older.sort(key=lambda info: info.modified, reverse=True)
    sizes = list(accumulate(info.size_bytes for info in older))
    few = [i.key for i, size in zip(older, sizes, strict=True) if size <= KEPT_BYTES]
    doomed = {info.key for info in older} - set(few[: KEPT_DAMAGED - 1])
    bucket.delete([key, *sorted(doomed)])
    return kept


@dataclass(frozen=True)
class _Object:
    """An object of a model that may be damaged.

    Attributes:
        decode: Raises RecordError if the bytes are damaged.
        reconstruct: Takes the damaged bytes, writes the object again, and says what was done.
    """

    key: str
    decode: Callable[[bytes], object]
    reconstruct: Callable[[bytes], str]


@dataclass(frozen=True)
class _Damage:
    """What is wrong with an object, and its bytes."""

    sentence: str
    data: bytes


def _damage(bucket: Bucket, item: _Object) -> _Damage | None:
    """The damage of an object; a record of a newer format is not damaged."""
    try:
        data = bucket.get(item.key)
    except ObjectMissing:
        return None
    try:
        item.decode(data)
    except NewerFormat:
        return None
    except RecordError as error:
        return _Damage(f"{bucket.name}/{item.key} is damaged: {error}.", data)
    return None


def _refuse_newer(model: Model) -> None:
    """Raise ObjectNewer if a record cannot be read that others would be reconstructed from."""
    for item in _objects(model, missing=False):
        with suppress(ObjectMissing, ObjectDamaged):
            read_record(model.bucket, item.key, item.decode, remedy="")


def _repaired(model: Model, objects: Iterable[_Object]) -> list[str]:
    bucket = model.bucket
    done: list[str] = []
    for item in objects:  # the next one is listed after this one is repaired
        damage = _damage(bucket, item)
        if damage is not None:
            if not done:
                _refuse_newer(model)
            kept = set_aside(bucket, model.prefix, item.key, damage.data)
            result = item.reconstruct(damage.data)
            done.append(
                f"{damage.sentence} {result} The damaged one is kept as {bucket.name}/{kept}."
            )
    return done


def _refilled(model: Model) -> list[str]:
    """Write what the checkpoints say must be there, but is not."""
    bucket, prefix = model.bucket, model.prefix
    newest = max(whole_checkpoints(bucket, prefix), default=None)
    if newest is None:
        return []
    done = []
    for key, write in (
        (keys.coach_checkpoint(prefix), _write_pointer),
        (keys.deepracer_checkpoints(prefix), _write_scores),
    ):
        if not bucket.exists(key):
            _refuse_newer(model)
            done.append(f"{bucket.name}/{key} is missing. {write(model, b'')}")
    known = read_history(bucket, prefix)
    if len(known) < newest.number - 1:  # the newest iteration is in the checkpoint's record
        _refuse_newer(model)
        found = reconstruct_history(bucket, prefix)
        if len(found) > len(known):
            write_history(bucket, prefix, found)
            lost = len(found) - len(known)
            done.append(
                f"{bucket.name}/{keys.history(prefix)} is missing, or {lost} iterations of it. "
                f"It was reconstructed with {len(found)} iterations."
            )
    return done


def _refilled_metrics(model: Model) -> list[str]:
    """Write the episodes of finished iterations that have a trace, but are not in the metrics."""
    bucket, prefix = model.bucket, model.prefix
    finished = max((name.number for name in whole_checkpoints(bucket, prefix)), default=0)
    traced = traced_iterations(bucket, prefix)
    done = []
    for worker in model.workers:
        key = keys.training_metrics(model.metrics_prefix, worker)
        records = read_all_metrics(bucket, key)
        if any(r.iteration is None for r in records):
            continue  # version 0.1.0 has not written which they are of
        known = {r.iteration for r in records if r.phase == "training"}
        lost = [n for n, keys_ in traced.items() if worker in keys_ and n not in known]
        if not any(n < finished for n in lost):
            continue
        result = _write_metrics(model, worker, b"")
        done.append(f"{bucket.name}/{key} is missing, or {len(lost)} iterations of it. {result}")
    return done


def _objects(model: Model, *, missing: bool) -> Iterator[_Object]:
    """All objects, each after those that it is reconstructed from."""
    bucket, prefix = model.bucket, model.prefix
    for number in evaluated_numbers(bucket, prefix):
        key = keys.evaluation_result(prefix, number)
        yield _Object(key, EvaluationResult.decode, lambda _: "Training continues without it.")
    for key in (keys.history(prefix), *list_parts(bucket, keys.history(prefix))):
        yield _Object(key, decode_history, partial(_write_history, model))
    names = map(str, whole_checkpoints(bucket, prefix))
    yield from _small(model, names, missing=missing)
    yield from _metrics(model)
    for info in bucket.list(keys.status_folder(prefix)):
        yield _Object(info.key, ActivityRecord.decode, lambda _: _REWRITTEN)


def _small(model: Model, names: Iterable[str], *, missing: bool) -> Iterator[_Object]:
    """The records of these checkpoints, and what there is once in a model or its runs."""
    prefix = model.prefix
    for name in names:
        key = keys.checkpoint_record(prefix, name)
        record = partial(CheckpointRecord.decode_of, name)
        yield _Object(key, record, partial(_write_record, model, name))

    def pointer(data: bytes) -> None:
        name = str(decode_pointer(data))
        if missing:
            _refuse_missing(model, name)

    def scores(data: bytes) -> None:
        found = Scores.decode(data)
        if missing:
            _refuse_missing(model, found.best_checkpoint.name, found.last_checkpoint.name)

    yield _Object(keys.coach_checkpoint(prefix), pointer, partial(_write_pointer, model))
    yield _Object(keys.deepracer_checkpoints(prefix), scores, partial(_write_scores, model))
    yield _Object(keys.milestones(prefix), Milestones.decode, partial(_write_milestones, model))
    yield _Object(keys.lease(prefix), Lease.decode, lambda _: _REWRITTEN)
    yield _Object(keys.outcome(prefix), RunOutcome.decode, lambda _: _REWRITTEN)


def _metrics(model: Model) -> Iterator[_Object]:
    for worker in model.workers:
        whole = keys.training_metrics(model.metrics_prefix, worker)
        for key in (whole, *list_parts(model.bucket, whole)):
            yield _Object(key, decode_metrics, partial(_write_metrics, model, worker))


def _refuse_missing(model: Model, *names: str) -> None:
    """Raise RecordError if a checkpoint has no weights, neither PyTorch nor TensorFlow ones."""
    listed = {info.key for info in model.bucket.list(keys.model_folder(model.prefix))}
    for name in names:
        parts = (".safetensors", ".index")
        if not listed & {keys.checkpoint_part(model.prefix, name, part) for part in parts}:
            raise RecordError(f"it names {name}, which does not exist")


def _write_history(model: Model, damaged: bytes) -> str:
    records = reconstruct_history(model.bucket, model.prefix, [damaged])
    write_history(model.bucket, model.prefix, records)
    return f"It was reconstructed with {len(records)} iterations."


def _write_record(model: Model, name: str, _damaged: bytes) -> str:
    try:
        history = read_history(model.bucket, model.prefix)
    except ObjectDamaged:
        history = []
    record = reconstruct_record(model.bucket, model.prefix, checkpoint_name(name), history)
    if record is None:
        return "That checkpoint is skipped."
    model.bucket.put(keys.checkpoint_record(model.prefix, name), record.encode())
    return "It was reconstructed from the weights and the history."


def _write_pointer(model: Model, _damaged: bytes) -> str:
    newest = max(whole_checkpoints(model.bucket, model.prefix), default=None)
    if newest is None:
        return "The model has no checkpoint to point to."
    model.bucket.put(keys.coach_checkpoint(model.prefix), str(newest).encode())
    return f"It names {newest} again."


def _write_scores(model: Model, _damaged: bytes) -> str:
    scores = reconstruct_scores(model.bucket, model.prefix, model.metric)
    if scores is None:
        return "It will be rewritten with the next checkpoint."
    write_scores(model.bucket, model.prefix, scores)
    best, last = scores.best_checkpoint.name, scores.last_checkpoint.name
    return f"It was reconstructed: the best is {best}, the last is {last}."


def _write_milestones(model: Model, damaged: bytes) -> str:
    milestones = reconstruct_milestones(model.bucket, model.prefix, damaged)
    write_milestones(model.bucket, model.prefix, milestones)
    reached = ", ".join(f"{kind} is {found.checkpoint}" for kind, found in milestones.reached())
    return f"It was reconstructed: {reached or 'no milestone is known'}."


def _write_metrics(model: Model, worker: int, damaged: bytes) -> str:
    key = keys.training_metrics(model.metrics_prefix, worker)
    parts = list_parts(model.bucket, key)
    files = [damaged, *readable_objects(model.bucket, [key, *parts])]
    records = reconstruct_metrics(model.bucket, model.prefix, worker, files)
    model.bucket.put(key, encode_metrics(records, model.metric))
    model.bucket.delete(parts)
    return f"It was reconstructed with {len(records)} episodes."

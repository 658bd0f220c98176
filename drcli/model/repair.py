"""Finds damaged objects of a model, sets them aside and reconstructs them.

A full disk, interrupted copy or editor damages objects; they stay in `runs/<prefix>/damaged/`. Only
who may write repairs: the trainer, or a command while none runs. Others report `find_damage`.
"""

import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import accumulate

from drcli.base.json_record import NewerFormat, RecordError
from drcli.bucket.bucket import (
    Bucket,
    ObjectDamaged,
    ObjectMissing,
    ObjectNewer,
    read_record,
    remedy_of,
)
from drcli.model import keys
from drcli.model.best_checkpoint import evaluated_numbers, read_scores, write_scores
from drcli.model.growing_file import combined_metrics, list_parts, read_parts
from drcli.model.history import HistoryReader, read_history, write_history
from drcli.model.milestones import Milestones, write_milestones
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import (
    readable_objects,
    reconstruct_history,
    reconstruct_metrics,
    reconstruct_milestones,
    reconstruct_record,
    reconstruct_scores,
    traced_iterations,
    whole_checkpoints,
)
from drcli.model.training_records import at_once
from drcli.records.checkpoint import CheckpointRecord, checkpoint_name, decode_pointer
from drcli.records.episode_metrics import EpisodeMetrics, decode_metrics, encode_metrics
from drcli.records.iteration import IterationRecord, decode_history
from drcli.records.run_record import ActivityRecord, Lease
from drcli.records.scores import EvaluationResult, Scores
from drcli.records.training_record import RunOutcome

AGAIN_S = 0.03
_REWRITTEN = "It will be rewritten when the training continues."

KEPT_DAMAGED, KEPT_BYTES = 100, 256 << 20
"""How many damaged objects of a model are kept, and the largest size of the older ones."""


def find_damage(model: ModelStore) -> list[str]:
    """What is wrong, and what to do; nothing is changed."""
    found = (_told(model.bucket, item) for item in _objects(model, missing=False))
    return [text for text in found if text]


def find_small_damage(model: ModelStore, listed: Collection[str]) -> list[str]:
    """For small objects with fixed names and checkpoint records, by `listed` keys."""
    own = {keys.checkpoint_of(model.prefix, key) for key in listed} - {None}
    items = _small(model, [str(name) for name in own], missing=False)
    there = [item for item in items if item.key in listed]
    return sorted(text for text in at_once(partial(_told, model.bucket), there) if text)


def _told(bucket: Bucket, item: "_Object") -> str:
    """Reads damage again, as `read_record`: it may be being overwritten."""
    if _damage(bucket, item) is None:
        return ""
    time.sleep(AGAIN_S)
    damage = _damage(bucket, item)
    return "" if damage is None else f"{damage.sentence} {remedy_of(item.key)}"


def repair(model: ModelStore, *, missing: bool = True) -> list[str]:
    """Set damaged objects aside and reconstruct them, and missing ones.

    The embedded server deletes an old object before renaming the new. If killed then, no client can
    write it again. `missing`: a pointer to no checkpoint counts as damaged.

    Returns:
        For each, what was wrong, and what was done.

    Raises:
        ObjectNewer: Something is damaged, but some records are a newer drcli's; nothing is changed.
    """
    done = _repaired(model, _objects(model, missing=missing))
    with suppress(ObjectNewer):  # then what is missing may be in an object that cannot be read
        done += _refilled(model)
        done += _refilled_metrics(model)
    return done


def repair_metrics(model: ModelStore) -> list[str]:
    """Each worker writes its own."""
    return [*_repaired(model, _metrics(model)), *_refilled_metrics(model)]


def readable_history(
    model: ModelStore, reader: HistoryReader | None = None
) -> tuple[list[IterationRecord], list[str]]:
    """For readers that never write; and a sentence on damage."""
    reader = reader or HistoryReader()
    try:
        return reader.read(model.bucket, model.prefix), []
    except ObjectDamaged as error:
        return reconstruct_history(model), [f"{error} {error.remedy}"]


def readable_scores(model: ModelStore) -> tuple[Scores | None, list[str]]:
    """For readers that never write; and a sentence on damage."""
    try:
        return read_scores(model), []
    except ObjectDamaged as error:
        said = f"{error} {error.remedy}"
        return reconstruct_scores(model, model.metric), [said]


def read_metrics(bucket: Bucket, key: str) -> list[EpisodeMetrics]:
    return read_record(bucket, key, decode_metrics, remedy_of(key))


def read_all_metrics(bucket: Bucket, key: str) -> list[EpisodeMetrics]:
    parts = read_parts(bucket, key, partial(read_metrics, bucket))
    try:
        return combined_metrics(read_metrics(bucket, key), parts)
    except ObjectMissing:
        return combined_metrics([], parts)


def set_aside(model: ModelStore, key: str, data: bytes | None = None) -> str:
    """Move a damaged object, or the given bytes, to a returned key.

    Of older ones, `KEPT_DAMAGED` and `KEPT_BYTES` stay.
    """
    kept = keys.damaged(model.prefix, key, time.strftime("%Y%m%d%H%M%S", time.gmtime()))
    with suppress(ObjectMissing):
        model.bucket.put(kept, model.bucket.get(key) if data is None else data)
    older = [i for i in model.bucket.list(keys.damaged_folder(model.prefix)) if i.key != kept]
    older.sort(key=lambda info: info.modified, reverse=True)
    sizes = list(accumulate(info.size_bytes for info in older))
    few = [i.key for i, size in zip(older, sizes, strict=True) if size <= KEPT_BYTES]
    doomed = {info.key for info in older} - set(few[: KEPT_DAMAGED - 1])
    model.bucket.delete([key, *sorted(doomed)])
    return kept


@dataclass(frozen=True)
class _Object:
    """A maybe damaged object.

    Attributes:
        decode: Raises RecordError.
        reconstruct: Writes it from the damaged bytes; says what was done.
    """

    key: str
    decode: Callable[[bytes], object]
    reconstruct: Callable[[bytes], str]


@dataclass(frozen=True)
class _Damage:
    sentence: str
    data: bytes


def _damage(bucket: Bucket, item: _Object) -> _Damage | None:
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


def _refuse_newer(model: ModelStore) -> None:
    for item in _objects(model, missing=False):
        with suppress(ObjectMissing, ObjectDamaged):
            read_record(model.bucket, item.key, item.decode, remedy="")


def _repaired(model: ModelStore, objects: Iterable[_Object]) -> list[str]:
    bucket = model.bucket
    done: list[str] = []
    for item in objects:  # the next one is listed after this one is repaired
        damage = _damage(bucket, item)
        if damage is not None:
            if not done:
                _refuse_newer(model)
            kept = set_aside(ModelStore(bucket, model.prefix), item.key, damage.data)
            result = item.reconstruct(damage.data)
            done.append(
                f"{damage.sentence} {result} The damaged one is kept as {bucket.name}/{kept}."
            )
    return done


def _refilled(model: ModelStore) -> list[str]:
    bucket, prefix = model.bucket, model.prefix
    store = ModelStore(bucket, prefix)
    newest = max(whole_checkpoints(store), default=None)
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
    known = read_history(store)
    if len(known) < newest.number - 1:  # the newest iteration is in the checkpoint's record
        _refuse_newer(model)
        found = reconstruct_history(store)
        if len(found) > len(known):
            write_history(store, found)
            lost = len(found) - len(known)
            done.append(
                f"{bucket.name}/{keys.history(prefix)} is missing, or {lost} iterations of it. "
                f"It was reconstructed with {len(found)} iterations."
            )
    return done


def _refilled_metrics(model: ModelStore) -> list[str]:
    bucket, prefix = model.bucket, model.prefix
    store = ModelStore(bucket, prefix)
    finished = max((name.number for name in whole_checkpoints(store)), default=0)
    traced = traced_iterations(store)
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


def _objects(model: ModelStore, *, missing: bool) -> Iterator[_Object]:
    bucket, prefix = model.bucket, model.prefix
    store = ModelStore(bucket, prefix)
    for number in evaluated_numbers(store):
        key = keys.evaluation_result(prefix, number)
        yield _Object(key, EvaluationResult.decode, lambda _: "Training continues without it.")
    for key in (keys.history(prefix), *list_parts(bucket, keys.history(prefix))):
        yield _Object(key, decode_history, partial(_write_history, model))
    names = map(str, whole_checkpoints(store))
    yield from _small(model, names, missing=missing)
    yield from _metrics(model)
    for info in bucket.list(keys.status_folder(prefix)):
        yield _Object(info.key, ActivityRecord.decode, lambda _: _REWRITTEN)


def _small(model: ModelStore, names: Iterable[str], *, missing: bool) -> Iterator[_Object]:
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


def _metrics(model: ModelStore) -> Iterator[_Object]:
    for worker in model.workers:
        whole = keys.training_metrics(model.metrics_prefix, worker)
        for key in (whole, *list_parts(model.bucket, whole)):
            yield _Object(key, decode_metrics, partial(_write_metrics, model, worker))


def _refuse_missing(model: ModelStore, *names: str) -> None:
    """Raise RecordError without PyTorch or TensorFlow weights."""
    listed = {info.key for info in model.bucket.list(keys.model_folder(model.prefix))}
    for name in names:
        parts = (".safetensors", ".index")
        if not listed & {keys.checkpoint_part(model.prefix, name, part) for part in parts}:
            raise RecordError(f"it names {name}, which does not exist")


def _write_history(model: ModelStore, damaged: bytes) -> str:
    records = reconstruct_history(model, [damaged])
    write_history(model, records)
    return f"It was reconstructed with {len(records)} iterations."


def _write_record(model: ModelStore, name: str, _damaged: bytes) -> str:
    try:
        history = read_history(model)
    except ObjectDamaged:
        history = []
    record = reconstruct_record(model, checkpoint_name(name), history)
    if record is None:
        return "That checkpoint is skipped."
    model.bucket.put(keys.checkpoint_record(model.prefix, name), record.encode())
    return "It was reconstructed from the weights and the history."


def _write_pointer(model: ModelStore, _damaged: bytes) -> str:
    newest = max(whole_checkpoints(model), default=None)
    if newest is None:
        return "The model has no checkpoint to point to."
    model.bucket.put(keys.coach_checkpoint(model.prefix), str(newest).encode())
    return f"It names {newest} again."


def _write_scores(model: ModelStore, _damaged: bytes) -> str:
    scores = reconstruct_scores(model, model.metric)
    if scores is None:
        return "It will be rewritten with the next checkpoint."
    write_scores(model, scores)
    best, last = scores.best_checkpoint.name, scores.last_checkpoint.name
    return f"It was reconstructed: the best is {best}, the last is {last}."


def _write_milestones(model: ModelStore, damaged: bytes) -> str:
    milestones = reconstruct_milestones(model, damaged)
    write_milestones(model, milestones)
    reached = ", ".join(f"{kind} is {found.checkpoint}" for kind, found in milestones.reached())
    return f"It was reconstructed: {reached or 'no milestone is known'}."


def _write_metrics(model: ModelStore, worker: int, damaged: bytes) -> str:
    key = keys.training_metrics(model.metrics_prefix, worker)
    parts = list_parts(model.bucket, key)
    files = [damaged, *readable_objects(model.bucket, [key, *parts])]
    records = reconstruct_metrics(model, worker, files)
    model.bucket.put(key, encode_metrics(records, model.metric))
    model.bucket.delete(parts)
    return f"It was reconstructed with {len(records)} episodes."

"""Sets damaged objects of a model aside and writes what can be worked out again.

A full disk, interrupted copy or editor damages objects; they stay in `runs/<prefix>/damaged/`. Only
who may write repairs: the trainer, or a command while none runs. Readers take what is `readable_`.
"""

import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import accumulate

from drcli.base import errors
from drcli.base.errors import SettingsError
from drcli.base.json_record import NewerFormat, RecordError
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing, ObjectNewer, read_record
from drcli.config.editing import raised
from drcli.model import keys, lease, race_keys
from drcli.model.best_checkpoint import evaluated_numbers, write_scores
from drcli.model.checkpoints import Checkpoint, CheckpointsLost, CheckpointStore
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.growing_file import list_parts, read_all_metrics, write_whole
from drcli.model.history import read_history, write_history
from drcli.model.milestones import Milestones, write_milestones
from drcli.model.model_prefix import ModelListing, is_used
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import (
    readable_history,
    readable_records,
    reconstruct_history,
    reconstruct_metrics,
    reconstruct_milestones,
    reconstruct_record,
    reconstruct_scores,
)
from drcli.records.checkpoint import CheckpointRecord, checkpoint_name, decode_pointer
from drcli.records.episode_metrics import decode_metrics, encode_metrics
from drcli.records.iteration import decode_history
from drcli.records.run_record import ActivityRecord, Lease
from drcli.records.scores import EvaluationResult, Scores
from drcli.records.training_record import RunOutcome, TrainingStart

_SEED = re.compile(rb'"seed": ?(\d{1,15})\b')

KEPT_DAMAGED, KEPT_BYTES = 100, 256 << 20
"""How many damaged objects of a model are kept, and the largest size of the older ones."""


def repair_unless_trained(model: ModelStore, *, missing: bool = False) -> None:
    """Repair a model, and say so, while nobody trains it; `missing` as in `repair`."""
    if lease.live_holder(model) is None:
        for sentence in repair(model, missing=missing):
            errors.warn(sentence)


def repair(model: ModelStore, *, missing: bool = True) -> list[str]:
    """Set damaged objects aside and write them again, and missing ones; only while nobody trains.

    The embedded server deletes an old object before renaming the new. If killed then, no client can
    write it again. A model of the reference stays as it is: its checkpoints do not help. `missing`:
    a pointer to no checkpoint counts as damaged.

    Returns:
        For each, what was wrong, and what was done.

    Raises:
        ObjectNewer: Something is damaged, but some records are a newer drcli's; nothing is changed.
    """
    listed = ModelListing(model)
    if listed.kind == "tensorflow":
        return []
    return _repaired(listed, model_objects(listed, missing=missing))


def repair_metrics(model: ModelStore) -> list[str]:
    """Each worker writes its own."""
    listed = ModelListing(model)
    return _repaired(listed, _metrics(listed))


def set_aside(model: ModelStore, key: str, data: bytes) -> str:
    """Keep the content of a damaged object at a returned key.

    Of older ones, `KEPT_DAMAGED` and `KEPT_BYTES` stay.
    """
    kept = keys.damaged(model.prefix, key, time.strftime("%Y%m%d%H%M%S", time.gmtime()))
    model.bucket.put(kept, data)
    older = [i for i in model.bucket.list(keys.damaged_folder(model.prefix)) if i.key != kept]
    older.sort(key=lambda info: info.modified, reverse=True)
    sizes = accumulate(info.size_bytes for info in older)
    few = [i.key for i, size in zip(older, sizes, strict=True) if size <= KEPT_BYTES]
    model.bucket.delete({info.key for info in older} - set(few[: KEPT_DAMAGED - 1]))
    return kept


@dataclass(frozen=True)
class ModelObject:
    """A maybe damaged object.

    Attributes:
        decode: Raises RecordError.
        write: Writes it again or deletes it, and says so; nothing if it stays as it is.
        missing: What is missing, if anything is.
    """

    key: str
    decode: Callable[[bytes], object]
    write: Callable[[], str]
    missing: Callable[[], str] = lambda: ""


def _repaired(listed: ModelListing, objects: Iterable[ModelObject]) -> list[str]:
    place = listed.model.bucket.name
    done = []
    for item in objects:  # the next one is looked for after this one is repaired
        fault, damaged = _fault(listed, item)
        result = item.write() if fault else ""
        if result:
            listed.look()
            sentences = f"{place}/{item.key} {fault} {result}"
            if damaged is not None:
                kept = set_aside(listed.model, item.key, damaged)
                sentences += f" The damaged one is kept as {place}/{kept}."
            done.append(sentences)
    return done


def _fault(listed: ModelListing, item: ModelObject) -> tuple[str, bytes | None]:
    """What is wrong, and the content if it is damaged."""
    try:
        data = listed.model.bucket.get(item.key)
        item.decode(data)
    except ObjectMissing:
        pass
    except NewerFormat:
        return "", None
    except RecordError as error:
        _refuse_newer(listed)
        return f"is damaged: {str(error).removesuffix('.')}.", data
    with suppress(ObjectNewer):  # then what is missing may be in an object that cannot be read
        missing = item.missing()
        if missing:
            _refuse_newer(listed)
        return missing, None
    return "", None


def _refuse_newer(listed: ModelListing) -> None:
    for item in model_objects(listed):
        with suppress(ObjectMissing, ObjectDamaged):
            read_record(listed.model.bucket, item.key, item.decode)


def model_objects(listed: ModelListing, *, missing: bool = False) -> Iterator[ModelObject]:
    """All that a training reads again, in the order in which each needs those before."""
    model, prefix = listed.model, listed.model.prefix

    def dropped(key: str, decode: Callable[[bytes], object], result: str) -> ModelObject:
        return ModelObject(key, decode, partial(_drop, model, key, result))

    for number in evaluated_numbers(model):
        key = keys.evaluation_result(prefix, number)
        yield dropped(key, EvaluationResult.decode, "Training continues without it.")
    history, write = keys.history(prefix), partial(_write_history, model)
    for part in listed.objects:
        if keys.part_number(history, part) is not None:
            yield ModelObject(part, decode_history, write)
    yield ModelObject(history, decode_history, write, partial(_missing_iterations, listed))
    for name in map(str, listed.whole):
        key, record = keys.checkpoint_record(prefix, name), partial(_write_record, model, name)
        yield ModelObject(key, partial(CheckpointRecord.decode_of, name), record)

    def pointer(data: bytes) -> None:
        _refuse_missing(listed, str(decode_pointer(data)))

    def scores(data: bytes) -> None:
        found = Scores.decode(data)
        _refuse_missing(listed, found.best_checkpoint.name, found.last_checkpoint.name)

    key = keys.coach_checkpoint(prefix)
    yield ModelObject(
        key,
        pointer if missing else decode_pointer,
        partial(_write_pointer, listed),
        partial(_missing, listed, key),
    )
    key = keys.deepracer_checkpoints(prefix)
    yield ModelObject(
        key,
        scores if missing else Scores.decode,
        partial(_write_scores, model),
        partial(_missing, listed, key),
    )
    key = keys.milestones(prefix)
    yield ModelObject(key, Milestones.decode, partial(_write_milestones, model))
    yield from _metrics(listed)
    again = "It will be rewritten when the training continues."
    yield dropped(keys.lease(prefix), Lease.decode, again)
    yield dropped(keys.outcome(prefix), RunOutcome.decode, again)
    for info in model.bucket.list(keys.status_folder(prefix)):
        yield dropped(info.key, ActivityRecord.decode, again)
    for key, name, read in (
        (keys.hyperparameters(prefix), keys.HYPERPARAMETERS_FILE, Hyperparameters.from_bytes),
        (keys.model_metadata(prefix), keys.MODEL_METADATA_FILE, ModelMetadata.from_bytes),
    ):
        check = partial(_check_parameters, read, name)
        restore = partial(_restore_parameters, model, key, name, check)
        yield ModelObject(key, check, restore, partial(_missing, listed, key))
    key = keys.training_start(prefix)
    yield ModelObject(key, TrainingStart.decode, partial(_write_start, model, key))


def _metrics(listed: ModelListing) -> Iterator[ModelObject]:
    model = listed.model
    for worker in model.workers:
        key = keys.training_metrics(model.metrics_prefix, worker)
        write = partial(_write_metrics, model, worker)
        for part in list_parts(model.bucket, key):
            yield ModelObject(part, decode_metrics, write)
        yield ModelObject(key, decode_metrics, write, partial(_missing_episodes, listed, worker))


def _missing(listed: ModelListing, key: str) -> str:
    return "is missing." if listed.whole and key not in listed.objects else ""


def _missing_iterations(listed: ModelListing) -> str:
    if not listed.whole or listed.model.prefix.startswith(race_keys.folder()):
        return ""  # a race has a copy of one checkpoint, which never had a history
    known = len(read_history(listed.model))
    if known >= listed.whole[-1].number - 1:
        return ""  # the newest iteration is in the checkpoint's record
    lost = len(reconstruct_history(listed.model)) - known
    return f"is missing, or {lost} iterations of it." if lost > 0 else ""


def _missing_episodes(listed: ModelListing, worker: int) -> str:
    lost = [n for n, traces in listed.traces.items() if worker in traces]
    if not lost:
        return ""
    model, finished = listed.model, max((name.number for name in listed.whole), default=0)
    records = read_all_metrics(model.bucket, keys.training_metrics(model.metrics_prefix, worker))
    known = {r.iteration for r in records if r.phase == "training"}
    lost = [n for n in lost if n not in known]
    # Version 0.1.0 has not written which they are of.
    if any(r.iteration is None for r in records) or not any(n < finished for n in lost):
        return ""
    return f"is missing, or {len(lost)} iterations of it."


def _refuse_missing(listed: ModelListing, *names: str) -> None:
    """Raise RecordError without PyTorch or TensorFlow weights."""
    for name in names:
        parts = (".safetensors", ".index")
        weights = {keys.checkpoint_part(listed.model.prefix, name, part) for part in parts}
        if weights.isdisjoint(listed.objects):
            raise RecordError(f"it names {name}, which does not exist")


def _drop(model: ModelStore, key: str, result: str) -> str:
    model.bucket.delete([key])
    return result


def _write_history(model: ModelStore) -> str:
    records = reconstruct_history(model)
    write_history(model, records)
    return f"It was reconstructed with {len(records)} iterations."


def _write_record(model: ModelStore, name: str) -> str:
    key = keys.checkpoint_record(model.prefix, name)
    record = reconstruct_record(model, checkpoint_name(name), readable_history(model)[0])
    if record is None:
        return _drop(model, key, "That checkpoint is skipped.")
    model.bucket.put(key, record.encode())
    return "It was reconstructed from the weights and the history."


def _write_pointer(listed: ModelListing) -> str:
    model, newest = listed.model, max(listed.whole, default=None)
    key = keys.coach_checkpoint(model.prefix)
    if newest is None:
        return _drop(model, key, "The model has no checkpoint to point to.")
    model.bucket.put(key, str(newest).encode())
    return f"It names {newest} again."


def _write_scores(model: ModelStore) -> str:
    scores = reconstruct_scores(model, model.metric)
    if scores is None:
        key = keys.deepracer_checkpoints(model.prefix)
        return _drop(model, key, "It will be rewritten with the next checkpoint.")
    write_scores(model, scores)
    best, last = scores.best_checkpoint.name, scores.last_checkpoint.name
    return f"It was reconstructed: the best is {best}, the last is {last}."


def _write_milestones(model: ModelStore) -> str:
    milestones = reconstruct_milestones(model)
    write_milestones(model, milestones)
    reached = ", ".join(f"{kind} is {found.checkpoint}" for kind, found in milestones.reached())
    return f"It was reconstructed: {reached or 'no milestone is known'}."


def _write_metrics(model: ModelStore, worker: int) -> str:
    records = reconstruct_metrics(model, worker)
    key = keys.training_metrics(model.metrics_prefix, worker)
    write_whole(model.bucket, key, encode_metrics(records, model.metric))
    return f"It was reconstructed with {len(records)} episodes."


def _check_parameters(read: Callable[[bytes, str], object], name: str, data: bytes) -> None:
    try:
        read(data, name)
    except SettingsError as error:
        raise RecordError(str(error)) from error


def _restore_parameters(
    model: ModelStore, key: str, name: str, check: Callable[[bytes], None]
) -> str:
    """From a checkpoint, which has copies."""
    copies = [r.counters.inputs[name] for r in readable_records(model) if name in r.counters.inputs]
    saved = copies[-1].encode() if copies else b""
    try:
        check(saved)
    except RecordError:
        return ""  # the command that needs the file says what is wrong with it
    model.bucket.put(key, saved)
    return "It was restored from a checkpoint."


def _write_start(model: ModelStore, key: str) -> str:
    """Keep at least the seed: resuming needs it."""
    found = _SEED.search(model.bucket.get(key))
    seeds = [int(found[1])] if found else []
    seeds += [s for r in readable_records(model) if (s := r.counters.seed) is not None]
    if not seeds:
        lost = "Its seed is lost; the training continues with a new one."
        return _drop(model, key, lost)
    model.bucket.put(key, TrainingStart(seeds[-1]).encode())
    return f"Its seed, {seeds[-1]}, was restored."


# Tells a model whose checkpoints are all lost from one that was never trained.
#
# Beginning again at iteration 0 would overwrite the rest of it.


_PREFIX, _METRICS = "DR_LOCAL_S3_MODEL_PREFIX", "DR_LOCAL_S3_METRICS_PREFIX"


def refuse_lost(model: ModelStore) -> None:
    """As `load_unless_lost`."""
    load_unless_lost(ModelListing(model))


def load_unless_lost(
    listed: ModelListing,
    *,
    metrics_too: bool = False,
    in_environment: bool = False,
    with_optimizer: bool = False,
) -> Checkpoint | None:
    """Raise CheckpointsLost if a training must not begin here, with the command that starts over.

    Unless a checkpoint can be read or reconstructed, or none was published. The reference's count
    as readable. Nothing is changed. `metrics_too`: a setting names their place, too;
    `in_environment`: these settings are there.

    Returns:
        The newest checkpoint; None if none was looked for, or it must be reconstructed.
    """
    model = listed.model
    if not any(_tells_of_training(model.prefix, key) for key in listed.objects):
        return None
    store = CheckpointStore(model)
    with suppress(CheckpointsLost):
        found = store.load_latest(with_optimizer=with_optimizer)
        if found is not None:
            return found
    if listed.has_tensorflow:
        return None
    history = reconstruct_history(model)
    if any(reconstruct_record(model, name, history) is not None for name in listed.whole):
        return None
    names = {*listed.checkpoints.values(), store.pointed()}
    numbers = sorted({name.number for name in names if name is not None})
    sizes = {key: info.size_bytes for key, info in listed.objects.items()}
    traces = [n for n, own in listed.traces.items() if all(sizes[key] for key in own.values())]
    known = [r.iteration for r in history]
    trained = max([-1, *traces, *known, *(n - 1 for n in numbers)]) + 1
    beside = _free_name(model)
    values = f"{_PREFIX}={beside}"
    if metrics_too:
        values += f" {_METRICS}={keys.metrics_prefix(beside)}"
    command = f"{values} " if in_environment else f"dr-config set {values} && "
    raise CheckpointsLost(
        f"{model.url} was trained for {trained} iterations, but has no checkpoint that can be "
        f"read. Lost: {_counted(numbers, 'checkpoint')}. Left: the learning curve of "
        f"{_counted(known, 'iteration')}, traces of {_counted(traces, 'iteration')}, "
        f"{sum(map(bool, sizes.values()))} files with content in all. Nothing was changed.",
        remedy="Restore a checkpoint from a copy, or start over beside it, which deletes "
        f"nothing: `{command}dr-start-training`.",
    )


def _tells_of_training(prefix: str, key: str) -> bool:
    history = keys.history(prefix)
    return (
        key in (keys.coach_checkpoint(prefix), history)
        or keys.part_number(history, key) is not None
        or keys.training_trace_of(prefix, key) is not None
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

"""Puts damaged objects of a model aside, and writes them anew from what is whole.

A disk that fills up, a copy that breaks off or an editor leaves an object empty, cut short or full
of something else. The damaged one is kept under `runs/<prefix>/damaged/`. Only who may write to the
model may repair it: the trainer, or a command while nobody trains; others say what `damages` finds.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drcli.config.settings import Settings
from drcli.exchange.checkpoint import CheckpointName, encode_pointer
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.lease_record import Lease
from drcli.exchange.scores import Scores
from drcli.exchange.training_metrics import EpisodeMetrics, decode_metrics, encode_metrics
from drcli.exchange.worker_state import ActivityRecord
from drcli.store import keys
from drcli.store.best_checkpoint import (
    evaluated_numbers,
    read_evaluation,
    read_scores,
    write_scores,
)
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record
from drcli.store.checkpoints import CheckpointStore
from drcli.store.history import read_history, write_history
from drcli.store.reconstruct import (
    reconstruct_history,
    reconstruct_metrics,
    reconstruct_record,
    reconstruct_scores,
    whole_checkpoints,
)


@dataclass(frozen=True)
class Model:
    """A model whose objects are looked after.

    Attributes:
        bucket: Holds it.
        prefix: Where.
        metrics_prefix: Where its metrics lie.
        metric: DR_TRAIN_BEST_MODEL_METRIC.
        workers: The simulation workers whose metrics are looked after.
    """

    bucket: Bucket
    prefix: str
    metrics_prefix: str
    metric: str = "progress"
    workers: Sequence[int] = (0,)

    @staticmethod
    def of(settings: Settings, bucket: Bucket, prefix: str) -> "Model":
        """A model in the bucket; what settings say of their own one counts for it alone."""
        own = prefix == settings.model_prefix
        return Model(
            bucket,
            prefix,
            settings.metrics_prefix if own else keys.metrics_prefix(prefix),
            settings.train_best_model_metric,
            range(settings.workers if own else 1),
        )


def damages(model: Model) -> list[str]:
    """What is damaged, a sentence each; nothing is changed."""
    return [reason for _, reason, _ in _damaged(model, missing=False)]


def repair(model: Model, *, missing: bool = True) -> list[str]:
    """Put what is damaged aside and reconstruct it.

    Args:
        model: Which.
        missing: Whether a pointer to a checkpoint that is not there counts as damaged.

    Returns:
        What was damaged and what became of it, a sentence each.
    """
    return _repaired(model, _damaged(model, missing=missing))


def repair_metrics(model: Model) -> list[str]:
    """The same for the metrics of the workers alone, each of which a worker writes itself."""
    return _repaired(model, _damaged_metrics(model))


def readable_history(model: Model) -> tuple[list[IterationRecord], list[str]]:
    """The learning curve for those who only look, and a sentence where it is damaged."""
    try:
        return read_history(model.bucket, model.prefix), []
    except ObjectDamaged as error:
        data = model.bucket.get(keys.history(model.prefix))
        return reconstruct_history(model.bucket, model.prefix, data), [str(error)]


def readable_scores(model: Model) -> tuple[Scores | None, list[str]]:
    """The index for those who only look, and a sentence where it is damaged."""
    try:
        return read_scores(model.bucket, model.prefix), []
    except ObjectDamaged as error:
        return reconstruct_scores(model.bucket, model.prefix, model.metric), [str(error)]


def read_metrics(bucket: Bucket, key: str) -> list[EpisodeMetrics]:
    """The records of a worker's TrainingMetrics.json.

    Raises:
        ObjectMissing: There is no file.
        ObjectDamaged: It is something else.
    """
    remedy = "Go on with `dr-start-training --resume`, which reconstructs it."
    return read_record(bucket, key, decode_metrics, remedy)


def set_aside(bucket: Bucket, prefix: str, key: str) -> str:
    """Keep a damaged object where nothing takes it for a part of the model, and delete it.

    Returns:
        The key under which it is kept.
    """
    kept = keys.damaged(prefix, key, time.strftime("%Y%m%d%H%M%S", time.gmtime()))
    with suppress(ObjectMissing):
        bucket.put(kept, bucket.get(key))
    bucket.delete([key])
    return kept


def _repaired(model: Model, damaged: Iterator["_Damage"]) -> list[str]:
    told = []
    for key, reason, reconstruct in damaged:  # the next is looked for once this one is done
        kept = set_aside(model.bucket, model.prefix, key)
        told.append(
            f"{reason} {reconstruct()} The damaged one is kept as {model.bucket.name}/{kept}."
        )
    return told


_Damage = tuple[str, str, Callable[[], str]]
"""Key of an object, what is wrong with it, and what reconstructs it once it is put aside."""


def _damaged(model: Model, *, missing: bool) -> Iterator[_Damage]:
    """One after the other, in the order in which they are reconstructed from each other."""
    yield from _damaged_evaluations(model)
    yield from _damaged_history(model)
    yield from _damaged_records(model)
    yield from _damaged_pointer(model, missing)
    yield from _damaged_scores(model, missing)
    yield from _damaged_metrics(model)
    yield from _damaged_states(model)


def _damaged_evaluations(model: Model) -> Iterator[_Damage]:
    for number in evaluated_numbers(model.bucket, model.prefix):
        try:
            read_evaluation(model.bucket, model.prefix, number)
        except ObjectMissing:
            continue
        except ObjectDamaged as error:
            key = keys.evaluation_result(model.prefix, number)
            yield key, str(error), lambda: "Training continues without it."


def _damaged_history(model: Model) -> Iterator[_Damage]:
    bucket, prefix, key = model.bucket, model.prefix, keys.history(model.prefix)
    try:
        read_history(bucket, prefix)
    except ObjectDamaged as error:
        before = bucket.get(key)

        def reconstruct() -> str:
            records = reconstruct_history(bucket, prefix, before)
            write_history(bucket, prefix, records)
            return f"It was reconstructed with {len(records)} iterations."

        yield key, str(error), reconstruct


def _damaged_records(model: Model) -> Iterator[_Damage]:
    bucket, prefix = model.bucket, model.prefix
    store = CheckpointStore(bucket, prefix)
    for name in whole_checkpoints(bucket, prefix):
        key = keys.checkpoint_record(prefix, str(name))
        try:
            store.record(str(name))
        except ObjectMissing:
            continue
        except ObjectDamaged as error:

            def reconstruct(name: CheckpointName = name, key: str = key) -> str:
                record = reconstruct_record(bucket, prefix, name, _known_history(model))
                if record is None:
                    return "That checkpoint is skipped."
                bucket.put(key, record.encode())
                return "It was reconstructed from the weights and the history."

            yield key, str(error), reconstruct


def _damaged_pointer(model: Model, missing: bool) -> Iterator[_Damage]:
    bucket, prefix, key = model.bucket, model.prefix, keys.coach_checkpoint(model.prefix)
    try:
        name = CheckpointStore(bucket, prefix).latest_name()
        if missing and name is not None:
            _refuse_missing(bucket, prefix, key, [name])
    except ObjectDamaged as error:

        def reconstruct() -> str:
            newest = max(whole_checkpoints(bucket, prefix), default=None)
            if newest is None:
                return "There is no checkpoint that it could name."
            bucket.put(key, encode_pointer(newest))
            return f"It names {newest} again."

        yield key, str(error), reconstruct


def _damaged_scores(model: Model, missing: bool) -> Iterator[_Damage]:
    bucket, prefix, key = model.bucket, model.prefix, keys.deepracer_checkpoints(model.prefix)
    try:
        found = read_scores(bucket, prefix)
        if missing and found is not None:
            named = [found.best_checkpoint.name, found.last_checkpoint.name]
            _refuse_missing(bucket, prefix, key, named)
    except ObjectDamaged as error:

        def reconstruct() -> str:
            scores = reconstruct_scores(bucket, prefix, model.metric)
            if scores is None:
                return "It will be rewritten with the next checkpoint."
            write_scores(bucket, prefix, scores)
            best, last = scores.best_checkpoint.name, scores.last_checkpoint.name
            return f"It was reconstructed: the best is {best}, the last is {last}."

        yield key, str(error), reconstruct


def _damaged_metrics(model: Model) -> Iterator[_Damage]:
    bucket = model.bucket
    for worker in model.workers:
        key = keys.training_metrics(model.metrics_prefix, worker)
        try:
            read_metrics(bucket, key)
        except ObjectMissing:
            continue
        except ObjectDamaged as error:
            before = bucket.get(key)

            def reconstruct(worker: int = worker, key: str = key, before: bytes = before) -> str:
                records = reconstruct_metrics(bucket, model.prefix, worker, before)
                bucket.put(key, encode_metrics(records, model.metric))
                return f"It was reconstructed with {len(records)} episodes."

            yield key, str(error), reconstruct


def _damaged_states(model: Model) -> Iterator[_Damage]:
    """What is true only while a run goes on; the next one writes it again."""
    bucket, prefix = model.bucket, model.prefix
    activities = [info.key for info in bucket.list(keys.status_folder(prefix))]
    decoders: dict[str, Callable[[bytes], object]] = {
        keys.lease(prefix): Lease.decode,
        **dict.fromkeys(activities, ActivityRecord.decode),
    }
    for key, decode in decoders.items():
        try:
            read_record(bucket, key, decode, "Delete it.")
        except ObjectMissing:
            continue
        except ObjectDamaged as error:
            yield key, str(error), lambda: "It will be rewritten when the training goes on."


def _refuse_missing(bucket: Bucket, prefix: str, key: str, named: Sequence[str]) -> None:
    """Raise ObjectDamaged where an object names a checkpoint that has no weights of any kind."""
    parts = (".safetensors", ".index")
    there = {info.key for info in bucket.list(keys.model_folder(prefix))}
    for name in named:
        if not there & {keys.checkpoint_part(prefix, name, part) for part in parts}:
            raise ObjectDamaged(
                f"{bucket.name}/{key} names {name}, which does not exist.",
                remedy="Go on with `dr-start-training --resume`, which writes it again.",
            )


def _known_history(model: Model) -> list[IterationRecord]:
    try:
        return read_history(model.bucket, model.prefix)
    except ObjectDamaged:
        return []

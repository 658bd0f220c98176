"""Puts damaged objects of a model aside, and writes them anew from what is whole.

A disk that fills up, a copy that breaks off or an editor leaves an object empty, cut short or full
of something else. The damaged one is kept under `runs/<prefix>/damaged/`. Only who may write to the
model may mend it: the trainer, or a command while nobody trains; others say what `damages` finds.
"""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass

from drcli.config.run_config import ModelConfig
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, get_json, put_json
from drcli.store.checkpoints import CheckpointStore
from drcli.store.evaluations import evaluated_numbers, read_evaluation
from drcli.store.history import IterationRecord, read_history
from drcli.store.reconstruct import (
    rebuilt_history,
    rebuilt_metrics,
    rebuilt_record,
    rebuilt_scores,
    whole_checkpoints,
)
from drcli.store.scores import Scores, read_scores, write_scores
from drcli.store.training_metrics import read_records, write_records


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
    def of(config: ModelConfig, bucket: Bucket, prefix: str) -> "Model":
        """A model in the bucket; what the settings say of theirs counts for it alone."""
        own = prefix == config.prefix
        return Model(
            bucket,
            prefix,
            config.metrics_prefix if own else keys.metrics_prefix(prefix),
            config.metric,
            range(config.workers if own else 1),
        )


def damages(model: Model) -> list[str]:
    """What is damaged, a sentence each; nothing is changed."""
    return [reason for _, reason, _ in _damaged(model, missing=False)]


def mend(model: Model, *, missing: bool = True) -> list[str]:
    """Put what is damaged aside and rebuild it.

    Args:
        model: Which.
        missing: Whether a pointer to a checkpoint that is not there counts as damaged.

    Returns:
        What was damaged and what became of it, a sentence each.
    """
    return _mended(model, _damaged(model, missing=missing))


def mend_metrics(model: Model) -> list[str]:
    """The same for the metrics of the workers alone, each of which a worker writes itself."""
    return _mended(model, _damaged_metrics(model))


def readable_history(model: Model) -> tuple[list[IterationRecord], list[str]]:
    """The learning curve for those who only look, and a sentence where it is damaged."""
    try:
        return read_history(model.bucket, model.prefix), []
    except ObjectDamaged as error:
        data = model.bucket.get(keys.history(model.prefix))
        return rebuilt_history(model.bucket, model.prefix, data), [str(error)]


def readable_scores(model: Model) -> tuple[Scores | None, list[str]]:
    """The index for those who only look, and a sentence where it is damaged."""
    try:
        return read_scores(model.bucket, model.prefix), []
    except ObjectDamaged as error:
        return rebuilt_scores(model.bucket, model.prefix, model.metric), [str(error)]


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


def _mended(model: Model, damaged: Iterator["_Damage"]) -> list[str]:
    told = []
    for key, reason, rebuild in damaged:  # the next one is looked for once this one is rebuilt
        kept = set_aside(model.bucket, model.prefix, key)
        told.append(f"{reason} {rebuild()} The damaged one is kept as {model.bucket.name}/{kept}.")
    return told


_Damage = tuple[str, str, Callable[[], str]]
"""Key of an object, what is wrong with it, and what rebuilds it once it is put aside."""


def _damaged(model: Model, *, missing: bool) -> Iterator[_Damage]:
    """One after the other, in the order in which they are rebuilt from each other."""
    yield from _damaged_evaluations(model)
    yield from _damaged_history(model)
    yield from _damaged_records(model)
    yield from _damaged_pointer(model, missing)
    yield from _damaged_scores(model, missing)
    yield from _damaged_metrics(model)
    yield from _damaged_notes(model)


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

        def rebuild() -> str:
            records = rebuilt_history(bucket, prefix, before)
            file = {"iterations": [asdict(record) for record in records]}
            bucket.put(key, json.dumps(file).encode())
            return f"It was rebuilt with {len(records)} iterations."

        yield key, str(error), rebuild


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

            def rebuild(name: keys.CheckpointName = name, key: str = key) -> str:
                record = rebuilt_record(bucket, prefix, name, _known_history(model))
                if record is None:
                    return "That checkpoint is skipped."
                put_json(bucket, key, asdict(record))
                return "It was rebuilt from the weights and the history."

            yield key, str(error), rebuild


def _damaged_pointer(model: Model, missing: bool) -> Iterator[_Damage]:
    bucket, prefix, key = model.bucket, model.prefix, keys.coach_checkpoint(model.prefix)
    try:
        name = CheckpointStore(bucket, prefix).latest_name()
        if missing and name is not None:
            _refuse_missing(bucket, prefix, key, [name])
    except ObjectDamaged as error:

        def rebuild() -> str:
            newest = max(whole_checkpoints(bucket, prefix), default=None)
            if newest is None:
                return "There is no checkpoint that it could name."
            bucket.put(key, str(newest).encode())
            return f"It names {newest} again."

        yield key, str(error), rebuild


def _damaged_scores(model: Model, missing: bool) -> Iterator[_Damage]:
    bucket, prefix, key = model.bucket, model.prefix, keys.deepracer_checkpoints(model.prefix)
    try:
        found = read_scores(bucket, prefix)
        if missing and found is not None:
            named = [found.best_checkpoint.name, found.last_checkpoint.name]
            _refuse_missing(bucket, prefix, key, named)
    except ObjectDamaged as error:

        def rebuild() -> str:
            scores = rebuilt_scores(bucket, prefix, model.metric)
            if scores is None:
                return "It will be rewritten with the next checkpoint."
            write_scores(bucket, prefix, scores)
            best, last = scores.best_checkpoint.name, scores.last_checkpoint.name
            return f"It was rebuilt: the best is {best}, the last is {last}."

        yield key, str(error), rebuild


def _damaged_metrics(model: Model) -> Iterator[_Damage]:
    bucket = model.bucket
    for worker in model.workers:
        key = keys.training_metrics(model.metrics_prefix, worker)
        try:
            read_records(bucket, key)
        except ObjectMissing:
            continue
        except ObjectDamaged as error:
            before = bucket.get(key)

            def rebuild(worker: int = worker, key: str = key, before: bytes = before) -> str:
                records = rebuilt_metrics(bucket, model.prefix, worker, before)
                write_records(bucket, key, records, model.metric)
                return f"It was rebuilt with {len(records)} episodes."

            yield key, str(error), rebuild


def _damaged_notes(model: Model) -> Iterator[_Damage]:
    """What is true only while a run goes on; the next one writes it again."""
    bucket, prefix = model.bucket, model.prefix
    notes = [info.key for info in bucket.list(keys.status_folder(prefix))]
    for key in [keys.lease(prefix), *notes]:
        try:
            if isinstance(get_json(bucket, key), dict):
                continue
            reason = f"{bucket.name}/{key} is damaged: it is not an object with keys."
        except ObjectMissing:
            continue
        except ObjectDamaged as error:
            reason = str(error)
        yield key, reason, lambda: "It will be rewritten when the training goes on."


def _refuse_missing(bucket: Bucket, prefix: str, key: str, named: Sequence[str]) -> None:
    """Raise ObjectDamaged where an object names a checkpoint that has no weights of any kind."""
    parts = (".safetensors", ".index")
    there = {info.key for info in bucket.list(keys.model_folder(prefix))}
    for name in named:
        if not there & {keys.checkpoint_part(prefix, name, part) for part in parts}:
            raise ObjectDamaged(
                f"{bucket.name}/{key} names {name}, which is not there.",
                remedy="Go on with `dr-start-training --resume`, which writes it again.",
            )


def _known_history(model: Model) -> list[IterationRecord]:
    try:
        return read_history(model.bucket, model.prefix)
    except ObjectDamaged:
        return []

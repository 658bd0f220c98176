"""Records of trainings: one object each, and one with their files' texts.

Outside the models, which they outlive. Only a model's owner writes its training's.
"""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

from drcli.bucket.bucket import (
    Bucket,
    ObjectDamaged,
    ObjectMissing,
    ObjectNewer,
    find_record,
    read_record,
    readable_record,
    readable_records,
)
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.training_record import (
    RunOutcome,
    StartSpending,
    TrainingFiles,
    TrainingRecord,
    TrainingState,
)

AT_ONCE = 16
"""Another continent answers after a quarter of a second."""

MOST_TEXT = 256 << 10
T = TypeVar("T")
R = TypeVar("R")


def at_once(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    known = list(items)
    if len(known) < 2:
        return [function(item) for item in known]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(function, known))


def read_training(model: ModelStore, training: str) -> TrainingRecord | None:
    """None if missing.

    Raises:
        ObjectDamaged: It is unreadable.
        ObjectNewer: A newer drcli wrote it.
    """
    key = keys.training_record(model.prefix, training)
    return find_record(model.bucket, key, TrainingRecord.decode)


def write_training(bucket: Bucket, record: TrainingRecord) -> None:
    bucket.put(keys.training_record(record.prefix, record.id), record.encode())


def read_trainings(bucket: Bucket, prefix: str = "") -> tuple[list[TrainingRecord], list[str]]:
    """Of a bucket or model; and a sentence for each unreadable one."""
    places = [
        (place, info.key)
        for info in bucket.list(keys.training_records_folder(prefix))
        if (place := keys.training_of(info.key)) is not None and prefix in ("", place[0])
    ]
    problems: list[str] = []

    def read(found: tuple[tuple[str, str], str]) -> TrainingRecord | None:
        (of, training), key = found
        try:
            record = read_training(ModelStore(bucket, of), training)
        except (ObjectDamaged, ObjectNewer) as error:
            problems.append(f"{error} {error.remedy}")
            return None
        if record is not None and (record.prefix, record.id) != (of, training):
            problems.append(f"{bucket.name}/{key} is the record of another training.")
            return None
        return record

    records = [record for record in at_once(read, places) if record is not None]
    return records, sorted(problems)


def read_files(model: ModelStore, training: str) -> Mapping[str, str]:
    key = keys.training_files(model.prefix, training)
    with suppress(ObjectMissing, ObjectDamaged, ObjectNewer):
        return read_record(model.bucket, key, TrainingFiles.decode).texts
    return {}


def add_files(model: ModelStore, training: str, texts: Mapping[str, str]) -> None:
    known = read_files(model, training)
    fresh = {key: text for key, text in texts.items() if len(text) <= MOST_TEXT}
    if not fresh.keys() <= known.keys():
        files = TrainingFiles({**known, **fresh})
        model.bucket.put(keys.training_files(model.prefix, training), files.encode())


def trainings_of(model: ModelStore) -> list[str]:
    places = (
        keys.training_of(info.key)
        for info in model.bucket.list(keys.training_records_folder(model.prefix))
    )
    return [place[1] for place in places if place is not None and place[0] == model.prefix]


def forget_training(model: ModelStore, training: str) -> None:
    model.bucket.delete(
        [keys.training_record(model.prefix, training), keys.training_files(model.prefix, training)]
    )


# How a training ended, in its record.


def ended_elsewhere(bucket: Bucket, record: TrainingRecord) -> TrainingRecord:
    outcome = (
        None if record.gone_at is not None else known_outcome(ModelStore(bucket, record.prefix))
    )
    return with_end(record, outcome)


def with_end(record: TrainingRecord, outcome: RunOutcome | None) -> TrainingRecord:
    newest = record.newest
    if not record.starts or newest.state not in ("running", "unknown"):
        return record
    state: TrainingState = "lost" if newest.state == "running" else "unknown"
    message, ended_at = newest.message, None
    if outcome is not None and newest.session in ("", outcome.session):
        # In a record that was worked out, the start has no session yet.
        newest = replace(newest, session=outcome.session, host=outcome.host or newest.host)
        state = "lost"
        if outcome.ended:
            state = _STATES.get(outcome.state, "unknown")
            message, ended_at = outcome.message, outcome.ended_at
    newest = replace(newest, state=state, message=message, ended_at=ended_at)
    starts = (*record.starts[:-1], newest)
    return replace(record, starts=starts, state=state, message=message, ended_at=ended_at)


_STATES: Mapping[str, TrainingState] = {
    "finished": "finished",
    "stopped": "stopped",
    "interrupted": "interrupted",
    "failed": "failed",
    "lost": "lost",
}


def known_outcome(model: ModelStore) -> RunOutcome | None:
    return readable_record(model.bucket, keys.outcome(model.prefix), RunOutcome.decode)


# What a training's starts have cost.


def read_spending(model: ModelStore) -> dict[str, StartSpending]:
    folder = keys.spending_folder(model.prefix)
    found = readable_records(model.bucket, folder, StartSpending.decode)
    return {one.session: one for one in found}


def with_spending(record: TrainingRecord, spent: Mapping[str, StartSpending]) -> TrainingRecord:
    """What the record knows stays: the objects are deleted with the model."""
    starts = tuple(
        replace(start, hours=one.hours, usd=one.usd)
        if (one := spent.get(start.session)) is not None
        else start
        for start in record.starts
    )
    named = {start.session for start in starts}
    others = [one for session, one in spent.items() if session not in named]
    hours = [start.hours for start in starts if start.hours is not None]
    hours += [one.hours for one in others]
    usd = [start.usd for start in starts if start.usd is not None]
    usd += [one.usd for one in others if one.usd is not None]
    return replace(
        record,
        starts=starts,
        hours=sum(hours) if hours else record.hours,
        usd=sum(usd) if usd else record.usd,
    )

"""Records of trainings: one object each, and one with their files' texts.

Outside the models, which they outlive. Only a model's owner writes its training's.
"""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from drcli.exchange.training_record import TrainingFiles, TrainingRecord
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, ObjectNewer, read_record
from drcli.store.remedies import remedy_of

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


def read_training(bucket: Bucket, prefix: str, training: str) -> TrainingRecord | None:
    """None if missing.

    Raises:
        ObjectDamaged: It is unreadable.
        ObjectNewer: A newer drcli wrote it.
    """
    try:
        key = keys.training_record(prefix, training)
        return read_record(bucket, key, TrainingRecord.decode, remedy_of(key))
    except ObjectMissing:
        return None


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
            record = read_training(bucket, of, training)
        except (ObjectDamaged, ObjectNewer) as error:
            problems.append(f"{error} {error.remedy}")
            return None
        if record is not None and (record.prefix, record.id) != (of, training):
            problems.append(f"{bucket.name}/{key} is the record of another training.")
            return None
        return record

    records = [record for record in at_once(read, places) if record is not None]
    return records, sorted(problems)


def read_files(bucket: Bucket, prefix: str, training: str) -> Mapping[str, str]:
    try:
        key = keys.training_files(prefix, training)
        return read_record(bucket, key, TrainingFiles.decode, remedy_of(key)).texts
    except (ObjectMissing, ObjectDamaged, ObjectNewer):
        return {}


def add_files(bucket: Bucket, prefix: str, training: str, texts: Mapping[str, str]) -> None:
    known = read_files(bucket, prefix, training)
    fresh = {key: text for key, text in texts.items() if len(text) <= MOST_TEXT}
    if not fresh.keys() <= known.keys():
        files = TrainingFiles({**known, **fresh})
        bucket.put(keys.training_files(prefix, training), files.encode())


def trainings_of(bucket: Bucket, prefix: str) -> list[str]:
    places = (
        keys.training_of(info.key) for info in bucket.list(keys.training_records_folder(prefix))
    )
    return [place[1] for place in places if place is not None and place[0] == prefix]


def forget_training(bucket: Bucket, prefix: str, training: str) -> None:
    bucket.delete([keys.training_record(prefix, training), keys.training_files(prefix, training)])

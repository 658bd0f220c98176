"""What a training's starts have cost."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

from drcli.base.json_record import RecordError
from drcli.exchange.spending import StartSpending
from drcli.exchange.training_record import TrainingRecord
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing


def read_spending(bucket: Bucket, prefix: str) -> dict[str, StartSpending]:
    found = {}
    for info in bucket.list(keys.spending_folder(prefix)):
        with suppress(ObjectMissing, RecordError):
            one = StartSpending.decode(bucket.get(info.key))
            found[one.session] = one
    return found


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

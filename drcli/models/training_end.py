"""How a training ended, in its record."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

from drcli.base.json_record import RecordError
from drcli.exchange.run_outcome import RunOutcome
from drcli.exchange.training_record import TrainingRecord, TrainingState
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing


def ended_elsewhere(bucket: Bucket, record: TrainingRecord) -> TrainingRecord:
    outcome = None if record.gone_at is not None else known_outcome(bucket, record.prefix)
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


def known_outcome(bucket: Bucket, prefix: str) -> RunOutcome | None:
    with suppress(ObjectMissing, RecordError):
        return RunOutcome.decode(bucket.get(keys.outcome(prefix)))
    return None

"""Reads the journal of a model: the events of all its starts, in order."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from drcli.base.errors import SettingsError
from drcli.base.json_record import RecordError
from drcli.config.settings import Settings
from drcli.exchange.journal_entry import JournalEntry
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.connect import open_running_bucket
from drcli.store.notes import StoredNote, read_notes


@dataclass(frozen=True)
class JournalEvent:
    """One event.

    Attributes:
        session: Unique name of the start that it belongs to.
        at: Unix seconds by the clock of its machine.
        kind: start, notice, fault, recovery, stage, upload, message or end; note for one of the
            racer.
        text: A sentence.
        facts: For programs.
    """

    session: str
    at: float
    kind: str
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class JournalReport:
    """The result of `dr-journal`.

    Attributes:
        model: As s3://bucket/prefix.
        events: Of all starts: one start after the other, each in its order.
        damaged: A sentence for each object with lines that cannot be read.
    """

    model: str
    events: list[JournalEvent] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)


def journal_of(settings: Settings, prefix: str | None) -> JournalReport:
    """`prefix` None: that of the settings.

    Raises:
        SettingsError: The prefix cannot be that of a model.
        StorageError: The bucket does not answer.
    """
    chosen = settings.model_prefix if prefix is None else prefix.rstrip("/")
    if not keys.is_valid_prefix(chosen):
        raise SettingsError(
            f"{prefix!r} is not the prefix of a model.",
            remedy="List the models with `dr-list-models`.",
        )
    bucket = open_running_bucket(settings.storage)
    if bucket is None:
        return JournalReport(f"s3://{settings.bucket}/{chosen}")
    report = read_journal(bucket, chosen)
    notes = read_notes(bucket, chosen)
    return replace(
        report,
        events=_with_notes(report.events, notes),
        damaged=[*report.damaged, *(note.problem for note in notes if note.problem)],
    )


def _with_notes(events: list[JournalEvent], notes: list[StoredNote]) -> list[JournalEvent]:
    found = list(events)
    for note in sorted(
        (note.record for note in notes if note.record is not None), key=lambda record: record.at
    ):
        later = (at for at, event in enumerate(found) if event.at > note.at)
        facts = {} if note.checkpoint is None else {"checkpoint": note.checkpoint}
        found.insert(next(later, len(found)), JournalEvent("", note.at, "note", note.text, facts))
    return found


def read_journal(bucket: Bucket, prefix: str) -> JournalReport:
    """Lines that cannot be read are counted."""
    report = JournalReport(f"s3://{bucket.name}/{prefix}")
    for info in bucket.list(keys.journal_folder(prefix)):
        session = keys.journal_session(prefix, info.key)
        if session is None:
            continue
        try:
            data = bucket.get(info.key)
        except ObjectMissing:
            continue
        bad = 0
        # Not splitlines(): a text may contain characters that count as ends of lines there.
        for line in filter(None, data.split(b"\n")):
            try:
                entry = JournalEntry.decode(line)
            except RecordError:
                bad += 1
            else:
                report.events.append(
                    JournalEvent(session, entry.at, entry.kind, entry.text, dict(entry.facts))
                )
        if bad:
            lines = "1 line" if bad == 1 else f"{bad} lines"
            report.damaged.append(f"{bucket.name}/{info.key}: {lines} cannot be read.")
    return report

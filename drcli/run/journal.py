"""The journal of a run: what happened to it, on which machine, in the bucket."""

import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from drcli.base.errors import DrError, SettingsError
from drcli.base.json_record import RecordError
from drcli.base.log import get_logger
from drcli.base.report import Log, Styled, View, bold, dim, printable, utc_second
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.bucket.connect import open_running_bucket
from drcli.config.fields import hidden
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.notes import StoredNote, read_notes
from drcli.records.run_record import JournalEntry, Kind
from drcli.run.periodic import Periodic

_logger = get_logger(__name__)

WRITE_S = 60.0
URGENT: tuple[Kind, ...] = ("start", "notice", "stage", "end")
"""Written at once: the machine may be gone soon."""

FIRST_KEPT, MOST_KEPT = 100, 2000
"""Each write sends all: uploads every hour for a year would be 9,000."""

_ADDRESS = re.compile(r"\b[a-zA-Z][a-zA-Z0-9+.-]*://[^\s'\"<>]+")


class Journal:
    """The events of one start, from any thread; the owner of the run writes them.

    The lease's `term` orders starts.
    """

    def __init__(
        self, prefix: str, term: int, session: str, noted: Sequence[JournalEntry] = ()
    ) -> None:
        self._key = keys.journal(prefix, term, session)
        self._lock = threading.Lock()
        self._entries = [replace(one, text=_without_secrets(one.text)) for one in noted]
        self._written = self._omitted = 0
        self._listeners: list[Callable[[JournalEntry], None]] = []
        self._open_bucket: Callable[[], Bucket] | None = None
        self._bucket: Bucket | None = None
        self._thread: Periodic | None = None

    def note(self, kind: Kind, text: str, **facts: object) -> None:
        """`facts` must be JSON. Passwords in addresses are hidden."""
        entry = JournalEntry(time.time(), kind, _without_secrets(text), facts)
        with self._lock:
            self._entries.append(entry)
            if len(self._entries) > MOST_KEPT:
                del self._entries[FIRST_KEPT]
                self._omitted += 1
            thread = self._thread
        if kind in URGENT and thread is not None:
            thread.ask(self._write)
        for listener in self._listeners:
            listener(entry)

    def listen(self, listener: Callable[[JournalEntry], None]) -> None:
        """Call a function with each event, in the thread that adds it."""
        self._listeners.append(listener)

    def start(self, open_bucket: Callable[[], Bucket]) -> None:
        self._open_bucket = open_bucket
        self._thread = Periodic("journal", self._write, WRITE_S)
        self._thread.start()

    def finish(self, patience_s: float, give_up: Callable[[], bool] = lambda: False) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.finish(self._write, patience_s, give_up)

    def write(self, bucket: Bucket) -> None:
        try:
            self._put(bucket)
        except DrError as error:
            _logger.warning("The journal could not be written: %s", error)

    def _write(self) -> None:
        if self._bucket is None and self._open_bucket is not None:
            self._bucket = self._open_bucket()
        if self._bucket is not None:
            self._put(self._bucket)

    def _put(self, bucket: Bucket) -> None:
        with self._lock:
            entries, omitted = tuple(self._entries), self._omitted
        noted = len(entries) + omitted
        if noted == self._written:
            return
        lines = [_line(entry) for entry in entries]
        if omitted:
            gap = JournalEntry(
                entries[FIRST_KEPT].at, "message", f"Events that are not kept: {omitted}."
            )
            lines.insert(FIRST_KEPT, gap.encode_line())
        bucket.put(self._key, b"".join(lines))
        self._written = noted


def _line(entry: JournalEntry) -> bytes:
    try:
        return entry.encode_line()
    except (TypeError, ValueError):
        return JournalEntry(entry.at, entry.kind, entry.text).encode_line()


def _without_secrets(text: str) -> str:
    return _ADDRESS.sub(lambda found: hidden("", found[0]), text)


# Reads the journal of a model: the events of all its starts, in order.


_STYLES = {
    "start": "bold cyan",
    "notice": "bold yellow",
    "fault": "red",
    "recovery": "green",
    "stage": "cyan",
    "end": "bold",
}


@dataclass(frozen=True)
class JournalEvent:
    """One event."""

    session: Annotated[str, "Unique name of the start that it belongs to."]
    at: Annotated[float, "Unix seconds by the clock of its machine."]
    kind: Annotated[
        str,
        "start, notice, fault, recovery, stage, upload, message or end; note for one of the racer.",
    ]
    text: Annotated[str, "A sentence."]
    facts: Annotated[Mapping[str, Any], "For programs."] = field(default_factory=dict)

    def pieces(self) -> tuple[str, ...]:
        kind = Styled(self.kind, _STYLES.get(self.kind, ""))
        return dim(utc_second(self.at)), kind, printable(self.text)


@dataclass(frozen=True)
class JournalReport:
    """The result of `dr-journal`."""

    model: Annotated[str, "As s3://bucket/prefix."]
    events: Annotated[
        list[JournalEvent], "Of all starts: one start after the other, each in its order."
    ] = field(default_factory=list)
    damaged: Annotated[list[str], "A sentence for each object with lines that cannot be read."] = (
        field(default_factory=list)
    )

    def view(self) -> View:
        if not self.events:
            return [f"{self.model} has no journal: it was never trained, or by an old version."]
        return [bold(self.model), Log([each.pieces() for each in self.events])]


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
    model = ModelStore(bucket, chosen)
    report = read_journal(model)
    notes = read_notes(model)
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


def read_journal(model: ModelStore) -> JournalReport:
    """Lines that cannot be read are counted."""
    report = JournalReport(model.url)
    for info in model.bucket.list(keys.journal_folder(model.prefix)):
        session = keys.journal_session(model.prefix, info.key)
        if session is None:
            continue
        try:
            data = model.bucket.get(info.key)
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
            report.damaged.append(f"{model.bucket.name}/{info.key}: {lines} cannot be read.")
    return report

"""The journal of a run: what happened to it, on which machine, in the bucket."""

import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.config.setting_problems import hidden
from drcli.exchange.journal_entry import JournalEntry, Kind
from drcli.runs.periodic import Periodic, within
from drcli.store import keys
from drcli.store.bucket import Bucket

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
            within(patience_s, lambda: thread.ask(self._write).wait(patience_s), give_up)
            thread.stop()

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

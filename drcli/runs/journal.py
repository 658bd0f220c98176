"""The journal of a run: what happened to it, on which machine, in the bucket for everybody."""

import threading
import time
from collections.abc import Callable

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.exchange.journal_entry import JournalEntry, Kind
from drcli.store import keys
from drcli.store.bucket import Bucket

_logger = get_logger(__name__)


class Journal:
    """The events of one start. Any thread may add some; the owner of the run writes them.

    Args:
        prefix: The model.
        term: Of the start's lease: starts are ordered by it.
        session: Of the start.
    """

    def __init__(self, prefix: str, term: int, session: str) -> None:
        self._key = keys.journal(prefix, term, session)
        self._lock = threading.Lock()
        self._entries: list[JournalEntry] = []
        self._written = 0
        self._listeners: list[Callable[[JournalEntry], None]] = []

    def note(self, kind: Kind, text: str, **facts: object) -> None:
        """Add an event: one sentence, and facts that programs can read."""
        entry = JournalEntry(time.time(), kind, text, facts)
        with self._lock:
            self._entries.append(entry)
        for listener in self._listeners:
            listener(entry)

    def listen(self, listener: Callable[[JournalEntry], None]) -> None:
        """Call a function with each event from now on, in the thread that adds it."""
        self._listeners.append(listener)

    def write(self, bucket: Bucket) -> None:
        """Write the events to the bucket if there are new ones; failures are logged."""
        with self._lock:
            entries = tuple(self._entries)
        if len(entries) == self._written:
            return
        try:
            bucket.put(self._key, b"".join(entry.encode_line() for entry in entries))
        except DrError as error:
            _logger.warning("The journal could not be written: %s", error)
        else:
            self._written = len(entries)

"""Counts the requests and bytes of a process to S3, and adds them up for a run.

Each process has a small file in the run's folder, continued when it restarts.
"""

import threading
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drcli.base.files import load_record, save_record
from drcli.base.json_record import SafeInt

WRITE_EVERY_S = 10.0
_END = ".requests.json"

PUT_LIST_USD = 0.005 / 1000
"""S3 Standard in us-east-1, November 2026, aws.amazon.com/s3/pricing. Elsewhere up to twice."""

GET_USD = 0.0004 / 1000
"""Also HEAD and others; deleting is free."""

NIGHT_HOURS = 10.0
_FREE = ("DeleteObject", "DeleteObjects", "AbortMultipartUpload")
_WRITING = ("Put", "Copy", "Post", "List", "Create", "Upload", "Complete")


@dataclass(frozen=True)
class RequestCount:
    """`puts` include COPY, POST and LIST, as billed; bytes are those of bodies."""

    session: str = ""
    puts: SafeInt = 0
    gets: SafeInt = 0
    deletes: SafeInt = 0
    sent_bytes: SafeInt = 0
    received_bytes: SafeInt = 0

    @property
    def requests(self) -> int:
        return self.puts + self.gets + self.deletes

    @property
    def list_price_usd(self) -> float:
        """Traffic in one region is free."""
        return PUT_LIST_USD * self.puts + GET_USD * self.gets

    def plus(self, other: "RequestCount") -> "RequestCount":
        return RequestCount(
            self.session,
            self.puts + other.puts,
            self.gets + other.gets,
            self.deletes + other.deletes,
            self.sent_bytes + other.sent_bytes,
            self.received_bytes + other.received_bytes,
        )


class RequestCounter:
    """Only answered requests. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = RequestCount()

    def attach(self, client: Any) -> None:
        events = client.meta.events
        events.register("before-send.s3", self._sent)
        events.register("response-received.s3", self._answered)

    def now(self) -> RequestCount:
        with self._lock:
            return self._count

    def add(self, operation: str) -> None:
        usual = "puts" if operation.startswith(_WRITING) else "gets"
        self._raise("deletes" if operation in _FREE else usual, 1)

    def _raise(self, name: str, by: int) -> None:
        with self._lock:
            changed: dict[str, Any] = {name: getattr(self._count, name) + by}
            self._count = replace(self._count, **changed)

    def _sent(self, request: Any, **_: object) -> None:
        self._raise("sent_bytes", _length(request.headers))

    def _answered(self, response_dict: Any = None, event_name: str = "", **_: object) -> None:
        if response_dict is None:
            return  # no answer came
        operation = event_name.rpartition(".")[2]
        self.add(operation)
        if not operation.startswith("Head"):  # whose length is that of an object that is not sent
            self._raise("received_bytes", _length(response_dict.get("headers", {})))


counter = RequestCounter()


class CountFile:
    """Written by a thread; an earlier session's counts are dropped."""

    def __init__(
        self, folder: Path, name: str, session: str, counted: RequestCounter = counter
    ) -> None:
        self._path = folder / f"{name}{_END}"
        before = load_record(RequestCount, self._path)
        self._before = RequestCount(session)
        if before is not None and before.session == session:
            self._before = before
        self._counted = counted
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="request count", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        self._ending.set()
        self.write()

    def write(self) -> None:
        """A full disk only makes it incomplete."""
        with suppress(OSError):
            save_record(self._path, self._before.plus(self._counted.now()))

    def _run(self) -> None:
        while not self._ending.wait(WRITE_EVERY_S):
            self.write()


def read_counts(folder: Path, session: str) -> RequestCount:
    total = RequestCount(session)
    for path in sorted(folder.glob(f"*{_END}")):
        count = load_record(RequestCount, path)
        if count is not None and count.session == session:
            total = total.plus(count)
    return total


def _length(headers: Any) -> int:
    value = headers.get("Content-Length") or headers.get("content-length") or 0
    try:
        return max(0, int(value))
    except (TypeError, ValueError):
        return 0

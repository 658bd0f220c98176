"""Counts the requests of a process to S3 servers and their bytes, and adds them up for a run.

Every process writes its counts into a small file in the run's folder. The file continues when a
process is started again, so the files of a start together have all its requests.
"""

import threading
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drcli.base.atomic_file import load_record, save_record

WRITE_EVERY_S = 10.0
"""How often a process writes its counts."""

_END = ".requests.json"

PUT_LIST_USD = 0.005 / 1000
"""Price of a PUT, COPY, POST or LIST request to S3 Standard in us-east-1, USD. Source of the two:
aws.amazon.com/s3/pricing, list prices in November 2026; other regions cost up to twice as much."""

GET_USD = 0.0004 / 1000
"""Price of a GET, HEAD or other request; those that delete are free."""

NIGHT_HOURS = 10.0
"""Length of a night for which requests are projected."""

_FREE = ("DeleteObject", "DeleteObjects", "AbortMultipartUpload")
_WRITING = ("Put", "Copy", "Post", "List", "Create", "Upload", "Complete")


@dataclass(frozen=True)
class RequestCount:
    """Requests and bytes.

    Attributes:
        session: Of the start of the training that they belong to.
        puts: Requests that S3 bills as PUT, COPY, POST or LIST.
        gets: GET, HEAD and all others.
        deletes: Requests that delete, which are free.
        sent_bytes: In bodies of requests.
        received_bytes: In bodies of answers.
    """

    session: str = ""
    puts: int = 0
    gets: int = 0
    deletes: int = 0
    sent_bytes: int = 0
    received_bytes: int = 0

    @property
    def requests(self) -> int:
        """All of them."""
        return self.puts + self.gets + self.deletes

    @property
    def list_price_usd(self) -> float:
        """What S3 bills for the requests by its list prices; traffic in one region is free."""
        return PUT_LIST_USD * self.puts + GET_USD * self.gets

    def plus(self, other: "RequestCount") -> "RequestCount":
        """The sum, with the session of this one."""
        return RequestCount(
            self.session,
            self.puts + other.puts,
            self.gets + other.gets,
            self.deletes + other.deletes,
            self.sent_bytes + other.sent_bytes,
            self.received_bytes + other.received_bytes,
        )


class RequestCounter:
    """Counts the answered requests of clients. For several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = RequestCount()

    def attach(self, client: Any) -> None:
        """Count the requests of a boto3 client of S3 from now on."""
        events = client.meta.events
        events.register("before-send.s3", self._sent)
        events.register("response-received.s3", self._answered)

    def now(self) -> RequestCount:
        """The count so far."""
        with self._lock:
            return self._count

    def add(self, operation: str) -> None:
        """Count one request, by the name of its operation in the interface of S3."""
        kind = "gets"
        if operation in _FREE:
            kind = "deletes"
        elif operation.startswith(_WRITING):
            kind = "puts"
        with self._lock:
            self._count = replace(self._count, **{kind: getattr(self._count, kind) + 1})

    def _sent(self, request: Any, **_: object) -> None:
        size = _length(request.headers)
        with self._lock:
            self._count = replace(self._count, sent_bytes=self._count.sent_bytes + size)

    def _answered(self, response_dict: Any = None, event_name: str = "", **_: object) -> None:
        if response_dict is None:
            return  # no answer came
        operation = event_name.rpartition(".")[2]
        self.add(operation)
        if operation.startswith("Head"):
            return  # the length is that of the object, which was not sent
        size = _length(response_dict.get("headers", {}))
        with self._lock:
            self._count = replace(self._count, received_bytes=self._count.received_bytes + size)


counter = RequestCounter()
"""Counts all requests of this process."""


class CountFile:
    """Writes the count of this process to a file every few seconds, in a thread.

    Args:
        folder: Of the run.
        name: Of the process, such as "sim-0".
        session: Of this start of the training; the counts of an earlier start are dropped.
        counted: What to write.
    """

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
        """Begin."""
        self._thread.start()

    def end(self) -> None:
        """Write the last count."""
        self._ending.set()
        self.write()

    def write(self) -> None:
        """Write the count so far; a full disk only makes it incomplete."""
        with suppress(OSError):
            save_record(self._path, self._before.plus(self._counted.now()))

    def _run(self) -> None:
        while not self._ending.wait(WRITE_EVERY_S):
            self.write()


def read_counts(folder: Path, session: str) -> RequestCount:
    """The sum of all processes of one start of a training."""
    total = RequestCount(session)
    for count in _counts(folder):
        if count.session == session:
            total = total.plus(count)
    return total


def _counts(folder: Path) -> Iterable[RequestCount]:
    for path in sorted(folder.glob(f"*{_END}")):
        count = load_record(RequestCount, path)
        if count is not None:
            yield count


def _length(headers: Any) -> int:
    """The length of a body as its headers have it; 0 if they do not."""
    value = headers.get("Content-Length") or headers.get("content-length") or 0
    try:
        return max(0, int(value))
    except (TypeError, ValueError):
        return 0

"""Sends logs to Amazon CloudWatch, in a thread that nothing waits for.

Group and names are those of DeepRacer-for-Cloud.
"""

import calendar
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from drcli.base import errors, log
from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.base.processes import Stopped
from drcli.bucket.s3_errors import error_code
from drcli.config.run_config import LogConfig
from drcli.outside.aws.aws_account import Account
from drcli.records.job import Job
from drcli.records.run_record import json_log, log_file
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import Ending
from drcli.run.periodic import Periodic
from drcli.run.read_logs import UnreadLog

# Turns lines of a log into events with a time.


TRACE = "SIM_TRACE_LOG:"
_STAMP = r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\.(\d{3})Z"
_TIMED = re.compile(rf'{_STAMP} |\{{"time": "{_STAMP}"')


@dataclass(frozen=True)
class LogEvent:
    """A line without a time has that of the line before."""

    at_ms: int
    text: str


class LogClock:
    """Gives lines times that never go back; `now_ms` until the first time."""

    def __init__(self, now_ms: int) -> None:
        self._now_ms = now_ms
        self._at_ms: int | None = None

    def pass_time(self, at_ms: int) -> None:
        """No later line was written before this time."""
        self._at_ms = max(self._at_ms or 0, at_ms)

    def events(self, data: bytes, *, with_traces: bool) -> Iterator[LogEvent]:
        for line in data.decode("utf-8", "replace").split("\n"):
            text = line.rstrip("\r")
            if not text.strip() or (text.startswith(TRACE) and not with_traces):
                continue
            found = _TIMED.match(text)
            if found is not None:
                with suppress(ValueError):  # such as the 99th month
                    self.pass_time(_milliseconds(found[1] or found[3], found[2] or found[4]))
            yield LogEvent(self._now_ms if self._at_ms is None else self._at_ms, text)


def _milliseconds(moment: str, milliseconds: str) -> int:
    parsed = time.strptime(moment, "%Y-%m-%dT%H:%M:%S")
    return calendar.timegm(parsed) * 1000 + int(milliseconds)


SEND_S = 10.0
PIECE_BYTES = 4 << 20
MOST_PIECES = 4
MOST_EVENTS, MOST_BYTES, EVENT_OVERHEAD_BYTES = 10_000, 1_000_000, 26
MOST_EVENT_BYTES = 250_000
MOST_SPAN_MS = 23 * 3_600_000
"""A little below the limits of PutLogEvents: 1,048,576 bytes with 26 for each event, 256 KB an
event, 24 hours.
"""


class LogService(Protocol):
    def put_log_events(self, **request: Any) -> Any:
        """Add events."""

    def create_log_group(self, **request: Any) -> Any:
        """Group of streams."""

    def create_log_stream(self, **request: Any) -> Any:
        """A stream."""


class LogSender:
    """Sends the logs `names` of a run, one stream each.

    `on_failure` is called once until the next success.
    """

    def __init__(
        self,
        job: Job,
        names: Sequence[str],
        *,
        connect: Callable[[], LogService] | None = None,
        clock: Callable[[], float] = time.time,
        on_failure: Callable[[DrError], None] = lambda error: None,
    ) -> None:
        storage, settings = job.config.storage, job.config.logs
        self._account = Account(storage.region, settings.cloud_watch_profile or storage.aws_profile)
        self._connect = connect or (lambda: self._account.client("logs"))
        self._on_failure = on_failure
        self._client: LogService | None = None
        self._streams = [
            _Stream(path, stream, settings, clock) for stream, path in _logs(job, names)
        ]
        self._thread = Periodic("CloudWatch", self.send, SEND_S)
        self.failure = ""
        """Why CloudWatch does not take the logs; empty if it does."""

    @property
    def first_stream(self) -> str:
        return self._streams[0].name

    @property
    def left_bytes(self) -> int:
        return sum(stream.left_bytes for stream in self._streams)

    def start(self) -> None:
        self._thread.start()

    def finish(self, patience_s: float, give_up: Callable[[], bool] = lambda: False) -> None:
        self._thread.finish(self.send_all, patience_s, give_up)

    def send(self) -> None:
        """A failure is reported once, and its lines are tried again."""
        self._send(unfinished=False)

    def send_all(self) -> None:
        self._send(unfinished=True)

    def _send(self, *, unfinished: bool) -> None:
        try:
            with self._account.trying("send the logs to CloudWatch (DR_CLOUD_WATCH_ENABLE)"):
                if self._client is None:
                    self._client = self._connect()
                for stream in self._streams:
                    stream.send(self._client, unfinished=unfinished)
            self.failure = ""
        except DrError as error:
            if str(error) != self.failure:
                self.failure = str(error)
                self._on_failure(error)


class _Stream:
    def __init__(
        self, path: Path, name: str, settings: LogConfig, clock: Callable[[], float]
    ) -> None:
        self.name = name
        self._group = settings.cloud_watch_log_group
        self._with_traces = settings.cloud_watch_sim_trace
        self._now = clock
        position = path.with_name(f"{path.name}{log.SENT}")
        self._unread = UnreadLog(path, position, PIECE_BYTES)
        self._clock = LogClock(int(clock() * 1000))
        self._exists = False

    @property
    def left_bytes(self) -> int:
        return self._unread.left_bytes()

    def send(self, client: LogService, *, unfinished: bool) -> None:
        for _ in range(MOST_PIECES):
            looked_ms = int(self._now() * 1000)
            if not self._unread.log.exists():
                return
            try:
                path, data = self._unread.next_piece()
            except OSError:  # rotated or deleted just now
                return
            if path is None:
                continue
            complete = path != self._unread.log
            if not data:
                if not complete:
                    self._clock.pass_time(looked_ms)
                    return
                self._unread.next_file()
                continue
            end = data.rfind(b"\n") + 1
            if end == 0 and not (complete or unfinished) and len(data) < PIECE_BYTES:
                return
            if end == 0 or ((complete or unfinished) and len(data) < PIECE_BYTES):
                end = len(data)
            for batch in batches(self._clock.events(data[:end], with_traces=self._with_traces)):
                self._put(client, batch)
            self._unread.advance(end)
            self._unread.save()

    def _put(self, client: LogService, batch: list[LogEvent]) -> None:
        entries = [{"timestamp": event.at_ms, "message": event.text} for event in batch]
        request = {"logGroupName": self._group, "logStreamName": self.name, "logEvents": entries}
        if not self._exists:
            self._create(client)
        try:
            client.put_log_events(**request)
        except Exception as error:
            if error_code(error) != "ResourceNotFoundException":
                raise
            self._create(client)  # somebody has deleted it meanwhile
            client.put_log_events(**request)

    def _create(self, client: LogService) -> None:
        try:
            self._create_stream(client)
        except Exception as error:
            if error_code(error) != "ResourceNotFoundException":
                raise
            _unless_it_exists(lambda: client.create_log_group(logGroupName=self._group))
            self._create_stream(client)
        self._exists = True

    def _create_stream(self, client: LogService) -> None:
        names = {"logGroupName": self._group, "logStreamName": self.name}
        _unless_it_exists(lambda: client.create_log_stream(**names))


def batches(events: Iterable[LogEvent]) -> Iterator[list[LogEvent]]:
    batch: list[LogEvent] = []
    size = 0
    for event in events:
        data = event.text.encode()
        if len(data) > MOST_EVENT_BYTES:
            text = data[:MOST_EVENT_BYTES].decode("utf-8", "ignore")
            event = LogEvent(event.at_ms, f"{text} ... ({len(data) - MOST_EVENT_BYTES:,} more)")
            data = event.text.encode()
        needed = len(data) + EVENT_OVERHEAD_BYTES
        full = len(batch) >= MOST_EVENTS or size + needed > MOST_BYTES
        if batch and (full or event.at_ms - batch[0].at_ms > MOST_SPAN_MS):
            yield batch
            batch, size = [], 0
        batch.append(event)
        size += needed
    if batch:
        yield batch


def _unless_it_exists(create: Callable[[], object]) -> None:
    try:
        create()
    except Exception as error:
        if error_code(error) != "ResourceAlreadyExistsException":
            raise


def _logs(job: Job, names: Iterable[str]) -> Iterator[tuple[str, Path]]:
    """JSON lines if there are any, unless they lack something."""
    settings, prefix = job.config.logs, job.config.model.prefix
    for name in names:
        path = log_file(job.directory, prefix, name)
        stream = f"{settings.cloud_watch_log_stream_prefix}{prefix}/{name}"
        as_json = settings.log_json and not settings.cloud_watch_sim_trace
        yield stream, json_log(path) if as_json else path


# Sends logs of trainings and evaluations to CloudWatch; failures end neither.


_logger = get_logger(__name__)

END_PATIENCE_S = 6.0
STOPPED_PATIENCE_S = 1.0


class CloudWatchLogs(Duty):
    name = "CloudWatch"

    def __init__(
        self,
        run: RunningTraining,
        *,
        connect: Callable[[], LogService] | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        super().__init__(run)
        self._connect = connect
        self._clock = clock
        self._sender: LogSender | None = None

    def start(self) -> None:
        settings = self.run.job.config.logs
        if not settings.cloud_watch_enable:
            return
        self._sender = LogSender(
            self.run.job,
            ["supervisor", *(child.name for child in self.run.children)],
            connect=self._connect,
            clock=self._clock,
            on_failure=self._failed,
        )
        group, first = settings.cloud_watch_log_group, self._sender.first_stream
        _logger.info("The logs are sent to CloudWatch: group %s, streams %s, ...", group, first)
        self._sender.start()

    def check(self) -> None:
        failure = self._sender and self._sender.failure  # the thread may change it meanwhile
        if failure:
            self.run.board.show(self.name, failure)
        else:
            self.run.board.clear(self.name)

    def after_release(self, ending: Ending) -> None:
        if self._sender is None:
            return
        self._sender.finish(min(END_PATIENCE_S, ending.left_s(0.8)), ending.hurried)
        if left := self._sender.left_bytes:
            _logger.warning("%s A start with --resume sends them.", _not_sent(left))

    def _failed(self, error: DrError) -> None:
        _logger.warning("%s %s", error, error.remedy)
        self.run.journal.note("fault", str(error))


@contextmanager
def sent_to_cloud_watch(
    job: Job, names: Sequence[str], *, connect: Callable[[], LogService] | None = None
) -> Iterator[None]:
    """Send the logs of an evaluation, just begun anew, during the `with` block."""
    if not job.config.logs.cloud_watch_enable:
        yield
        return
    sender = LogSender(job, names, connect=connect)
    sender.start()
    patience_s = STOPPED_PATIENCE_S
    try:
        yield
        patience_s = END_PATIENCE_S
    except DrError as error:
        patience_s = STOPPED_PATIENCE_S if isinstance(error, Stopped) else END_PATIENCE_S
        raise
    finally:
        sender.finish(patience_s)
        if sender.failure:
            errors.warn(sender.failure)
        elif left := sender.left_bytes:
            errors.warn(_not_sent(left))


def _not_sent(left_bytes: int) -> str:
    how_much = f"{left_bytes / 1e6:,.1f} MB" if left_bytes > 100_000 else "The newest lines"
    return f"{how_much} of the logs were not sent to CloudWatch in time."

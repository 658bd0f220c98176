"""Finds the log files of a run, and uploads their new lines in a thread."""

import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from drcli.base import log as log_files
from drcli.base.errors import DrError, SettingsError
from drcli.base.log import get_logger
from drcli.bucket.bucket import Bucket
from drcli.config.run_config import LogConfig
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.run_record import KINDS, json_log, log_file, log_folder, log_kind, reward_log
from drcli.run.read_logs import UnreadLog, read_piece
from drcli.run.timed_uploads import EventFileCopies

_logger = get_logger(__name__)

INTERVAL_S = 300.0

PART_BYTES = 4 << 20
"""What follows the last part is uploaded again each time."""

_CHECK_S = 0.1
_COMPARED_BYTES = 4 << 10
"""Equal beginnings mean the same log: they contain times."""


def begin_logs(directory: Path, prefix: str, max_mb: int) -> None:
    folders = [log_folder(directory, prefix, kind) for kind in KINDS]
    try:
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
        log_files.set_aside(folders, max_mb << 20)
    except OSError as e:
        raise SettingsError(
            f"{e.filename}: logs cannot be written there ({e.strerror or e}).",
            remedy=f"Check that you can write to {directory / 'data' / 'logs'}, or move it.",
        ) from e


def empty_logs(directory: Path, prefix: str, name: str) -> None:
    """Emptied, not deleted: a command may follow it."""
    log = log_file(directory, prefix, name)
    beside = [json_log(log), log_file(directory, prefix, reward_log(name))]
    with suppress(OSError):
        for path in (log, *beside):
            for part in log_files.older_parts(path):
                part.unlink(missing_ok=True)
            path.with_name(f"{path.name}{log_files.SENT}").unlink(missing_ok=True)
        for path in beside:
            path.unlink(missing_ok=True)
        os.truncate(log, 0)


class LogCopy:
    """The copy of one log in the bucket.

    S3 cannot append: parts (`sim-0.log.part-000001`, ...) are written once, `sim-0.log` has the
    newest lines. Any machine continues the parts. Above `max_bytes`, the oldest go.
    """

    def __init__(self, bucket: Bucket, key: str, log: Path, max_bytes: int) -> None:
        self._bucket = bucket
        self._key = key
        self._log = log
        self._max_bytes = max_bytes
        position_file = log.with_name(f"{log.name}{log_files.UPLOADED}")
        self._unread = UnreadLog(log, position_file, PART_BYTES)
        self._known = False
        self._parts: list[tuple[str, int]] = []
        self._next = 1
        self._newest = (0, 0, 0)

    def update(self, over: Callable[[], bool] = lambda: False, *, hurried: bool = False) -> None:
        """Until `over()`; if `hurried`, the end of the log first."""
        if not self._log.exists():
            return
        if not self._known:
            self._list_parts()
        if hurried and self.left_bytes() > PART_BYTES:
            ends = [_end_of(path) for path in (*log_files.older_parts(self._log)[-1:], self._log)]
            self._bucket.put(self._key, b"".join(ends)[-PART_BYTES:])
        while not over():
            path, data = self._unread.next_piece()
            if path is None:
                continue
            at = self._unread.at
            complete = path != self._log
            if complete and not data:
                self._unread.next_file()
            elif complete or len(data) >= PART_BYTES:
                self._unread.advance(self._put_part(data))
            else:
                newest = (at.number, at.offset, len(data))
                if newest != self._newest:
                    self._bucket.put(self._key, data)
                    self._newest = newest
                return
            self._unread.save()

    def left_bytes(self) -> int:
        at, left = self._unread.at, self._unread.left_bytes()
        return max(0, left - (self._newest[2] if self._newest[:2] == (at.number, at.offset) else 0))

    def _list_parts(self) -> None:
        for info in self._bucket.list(self._key.rpartition("/")[0] + "/"):
            number = keys.part_number(self._key, info.key)
            if number is not None:
                self._parts.append((info.key, info.size_bytes))
                self._next = number + 1
        data = self._bucket.get(self._key) if self._bucket.exists(self._key) else b""
        if data and not self._is_ours(data):
            # The newest lines of another machine: make them a part, or we would overwrite them.
            self._put_part(data, whole=True)
        self._known = True

    def _is_ours(self, data: bytes) -> bool:
        """They follow the uploaded parts, or are the end of the log, uploaded in a hurry."""
        at, older = self._unread.at, log_files.older_parts(self._log)
        path = next((part for part in older if log_files.number_of(part) == at.number), self._log)
        own = read_piece(path, at.offset, PART_BYTES)
        if data[:_COMPARED_BYTES] == own[: len(data)][:_COMPARED_BYTES]:
            return True
        ends = b"".join(_end_of(part) for part in (*older[-1:], self._log))
        return data[-_COMPARED_BYTES:] in ends

    def _put_part(self, data: bytes, *, whole: bool = False) -> int:
        end = len(data) if whole or len(data) < PART_BYTES else data.rfind(b"\n") + 1 or len(data)
        key = keys.part(self._key, self._next)
        self._bucket.put(key, data[:end])
        self._parts.append((key, end))
        self._next += 1
        while len(self._parts) > 1 and sum(size for _, size in self._parts) > self._max_bytes:
            self._bucket.delete([self._parts.pop(0)[0]])
        return end


def written_logs(
    directory: Path, prefix: str, settings: LogConfig, names: Sequence[str]
) -> list[tuple[str, Path]]:
    """The most important first; some may never appear."""
    logs = [(name, log_file(directory, prefix, name)) for name in names]
    prints = [reward_log(name) for name in names if name.startswith("sim")]
    lines = [(name, json_log(path)) for name, path in logs] if settings.log_json else []
    return [*logs, *((name, log_file(directory, prefix, name)) for name in prints), *lines]


class LogUpload:
    def __init__(
        self,
        open_bucket: Callable[[], Bucket],
        directory: Path,
        prefix: str,
        settings: LogConfig,
        names: Sequence[str],
        events: Path | None = None,
    ) -> None:
        self._open_bucket = open_bucket
        self._prefix, self._events = prefix, events
        self._max_bytes = settings.log_max_mb << 20
        self._logs = {
            keys.log(prefix, log_kind(name), path.name): path
            for name, path in written_logs(directory, prefix, settings, names)
        }
        self._copies: list[LogCopy | EventFileCopies] = []
        self._ending = threading.Event()
        self._due, self._sent = threading.Event(), threading.Event()
        self._hurried = False
        self._deadline_s = math.inf
        self._thread = threading.Thread(target=self._run, name="log upload", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def send(self, patience_s: float, given_up: Callable[[], bool] = lambda: False) -> None:
        """Upload what is new now, the newest lines first, before the end."""
        self._hurried = True
        self._deadline_s = time.monotonic() + patience_s
        self._sent.clear()
        self._due.set()
        while not (self._sent.wait(_CHECK_S) or self._is_over() or given_up()):
            pass

    def finish(self, patience_s: float, given_up: Callable[[], bool] = lambda: False) -> None:
        self._hurried = True
        self._deadline_s = time.monotonic() + patience_s
        self._ending.set()
        self._due.set()
        while self._thread.is_alive() and not self._is_over() and not given_up():
            self._thread.join(_CHECK_S)
        left = sum(copy.left_bytes() for copy in self._copies)
        if left or self._thread.is_alive():
            how_much = f"{left / 1e6:,.1f} MB" if left else "The newest part"
            _logger.warning(
                "%s of the %s could not be uploaded in time and is on this machine only, in "
                "%s. A start with --resume uploads it.",
                how_much,
                "logs" if self._events is None else "logs and event files",
                "data/logs" if self._events is None else "data/logs and data/tensorboard",
            )

    def _run(self) -> None:
        ends = False
        while not ends:
            self._due.wait(INTERVAL_S)
            self._due.clear()
            ends = self._ending.is_set()
            self._upload()
            if ends or not self._due.is_set():  # else the lines that `send` is about are missing
                self._sent.set()

    def _upload(self) -> None:
        try:
            if not self._copies:
                bucket = self._open_bucket()
                self._copies = [
                    LogCopy(bucket, key, path, self._max_bytes) for key, path in self._logs.items()
                ]
                if self._events is not None:
                    events = EventFileCopies(
                        ModelStore(bucket, self._prefix), self._events, self._max_bytes
                    )
                    self._copies.append(events)
            for copy in self._copies:
                copy.update(self._is_over, hurried=self._hurried)
        except DrError as error:
            _logger.warning("The logs could not be uploaded: %s", error)
        except OSError as error:
            _logger.warning("The logs could not be read: %s", error)

    def _is_over(self) -> bool:
        return time.monotonic() > self._deadline_s


def _end_of(path: Path) -> bytes:
    return read_piece(path, max(0, path.stat().st_size - PART_BYTES), PART_BYTES)

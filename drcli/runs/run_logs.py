"""Finds the log files of a run, and uploads them to the bucket.

Each process writes its own log. A thread of the supervisor uploads new lines; nothing waits for it.
"""

import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.base import log_files
from drcli.base.atomic_file import load_record, save_record
from drcli.base.errors import DrError, SettingsError
from drcli.base.log import get_logger
from drcli.store import keys
from drcli.store.bucket import Bucket

_logger = get_logger(__name__)

_FOLDERS = ("robomaker", "sagemaker")

INTERVAL_S = 300.0

PART_BYTES = 4 << 20
"""Size of a part in the bucket. What follows the last part is uploaded again each time."""

_CHECK_S = 0.1
"""Pause between two checks whether the last upload has ended."""

_COMPARED_BYTES = 4 << 10
"""Two logs that begin with so many equal bytes are the same log: they contain times."""


def log_file(directory: Path, prefix: str, worker: str) -> Path:
    """The log of a worker ("trainer", "supervisor", "sim-0", ...) on this machine.

    Simulation logs have their own folder, because log-guru fails if it finds any other log there.
    """
    return _folder(directory, prefix, log_kind(worker)) / f"{worker}.log"


def log_kind(worker: str) -> str:
    """The folder of a worker's log, on disk and in the bucket."""
    return _FOLDERS[0] if worker.startswith("sim") else _FOLDERS[1]


def begin_logs(directory: Path, prefix: str, max_mb: int) -> None:
    """Start new logs for a new training, and keep those of the last few trainings."""
    folders = [_folder(directory, prefix, kind) for kind in _FOLDERS]
    try:
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
        log_files.set_aside(folders, max_mb << 20)
    except OSError as e:
        raise SettingsError(
            f"{e.filename}: logs cannot be written there ({e.strerror or e}).",
            remedy=f"Check that you can write to {directory / 'data' / 'logs'}, or move it.",
        ) from e


@dataclass
class _Position:
    """How far a log is uploaded in complete parts: all files before `number`, `offset` bytes of it.

    The numbers are those of `log_files.current_number`.
    """

    number: int = 1
    offset: int = 0


class LogCopy:
    """The copy of one log in the bucket.

    S3 cannot append. So the copy consists of parts, `sim-0.log.part-000001` and so on, which are
    written once, and of `sim-0.log` with the newest lines. Joined in this order they are the log.
    A later start continues the parts, also on another machine.

    Args:
        bucket: Where to upload.
        key: The object with the newest lines.
        log: The file on this machine.
        max_bytes: Largest size of all parts together; the oldest are deleted first.
    """

    def __init__(self, bucket: Bucket, key: str, log: Path, max_bytes: int) -> None:
        self._bucket = bucket
        self._key = key
        self._log = log
        self._max_bytes = max_bytes
        self._position_file = log.with_name(f"{log.name}{log_files.UPLOADED}")
        self._position = _read_position(self._position_file, log)
        self._known = False
        self._parts: list[tuple[str, int]] = []
        self._next = 1
        self._newest = (0, 0, 0)

    def update(self, over: Callable[[], bool] = lambda: False, *, hurried: bool = False) -> None:
        """Upload new lines until `over()`; if `hurried`, upload the end of the log first."""
        if not self._log.exists():
            return
        if not self._known:
            self._list_parts()
        if hurried and self.left_bytes() > PART_BYTES:
            ends = [_end_of(path) for path in (*log_files.older_parts(self._log)[-1:], self._log)]
            self._bucket.put(self._key, b"".join(ends)[-PART_BYTES:])
        while not over():
            path, data = self._next_bytes()
            if path is None:
                continue
            at = self._position
            complete = path != self._log
            if complete and not data:
                self._position = _Position(at.number + 1)
            elif complete or len(data) >= PART_BYTES:
                self._position = _Position(at.number, at.offset + self._put_part(data))
            else:
                newest = (at.number, at.offset, len(data))
                if newest != self._newest:
                    self._bucket.put(self._key, data)
                    self._newest = newest
                return
            with suppress(OSError):  # a full disk: the next start uploads this part again
                save_record(self._position_file, self._position)

    def left_bytes(self) -> int:
        """Size of the part of the log that is not uploaded yet."""
        at = self._position
        left = -at.offset - (self._newest[2] if self._newest[:2] == (at.number, at.offset) else 0)
        for path in [*log_files.older_parts(self._log), self._log]:
            with suppress(OSError):
                number = None if path == self._log else log_files.number_of(path)
                left += path.stat().st_size if number is None or number >= at.number else 0
        return max(0, left)

    def _list_parts(self) -> None:
        """List the parts of an earlier start, and keep the newest lines of another machine."""
        folder = self._key.rpartition("/")[0] + "/"
        start = f"{self._key}.part-"
        for info in self._bucket.list(folder):
            number = info.key.removeprefix(start)
            if info.key.startswith(start) and number.isdigit():
                self._parts.append((info.key, info.size_bytes))
                self._next = int(number) + 1
        data = self._bucket.get(self._key) if self._bucket.exists(self._key) else b""
        if data and not self._is_ours(data):
            # The newest lines of another machine: make them a part, or we would overwrite them.
            self._put_part(data, whole=True)
        self._known = True

    def _is_ours(self, data: bytes) -> bool:
        """Whether the newest lines in the bucket come from this log.

        They follow the uploaded parts, or are the end of the log, uploaded first in a hurry.
        """
        at, older = self._position, log_files.older_parts(self._log)
        path = next((part for part in older if log_files.number_of(part) == at.number), self._log)
        own = _read(path, at.offset)
        if data[:_COMPARED_BYTES] == own[: len(data)][:_COMPARED_BYTES]:
            return True
        ends = b"".join(_end_of(part) for part in (*older[-1:], self._log))
        return data[-_COMPARED_BYTES:] in ends

    def _next_bytes(self) -> tuple[Path | None, bytes]:
        """The next file to upload and its new bytes; None if it has just been rotated."""
        at = self._position
        for part in log_files.older_parts(self._log):
            number = log_files.number_of(part)
            if number > at.number:  # files between were deleted because the log grew too large
                at = self._position = _Position(number)
            if number == at.number:
                return part, _read(part, at.offset)
        data = _read(self._log, at.offset)
        current = log_files.current_number(self._log)
        if current < at.number:  # the older files were deleted
            self._position = _Position(current)
        return (self._log if current == at.number else None), data

    def _put_part(self, data: bytes, *, whole: bool = False) -> int:
        """Upload a part that ends with a whole line; returns its size."""
        end = len(data) if whole or len(data) < PART_BYTES else data.rfind(b"\n") + 1 or len(data)
        key = f"{self._key}.part-{self._next:06d}"
        self._bucket.put(key, data[:end])
        self._parts.append((key, end))
        self._next += 1
        while len(self._parts) > 1 and sum(size for _, size in self._parts) > self._max_bytes:
            self._bucket.delete([self._parts.pop(0)[0]])
        return end


class LogUpload:
    """Uploads the logs of the named workers in a thread, the most important first."""

    def __init__(
        self,
        open_bucket: Callable[[], Bucket],
        directory: Path,
        prefix: str,
        max_mb: int,
        names: Sequence[str],
    ) -> None:
        self._open_bucket = open_bucket
        self._max_bytes = max_mb << 20
        self._logs = {
            keys.log(prefix, log_kind(name), name): log_file(directory, prefix, name)
            for name in names
        }
        self._copies: list[LogCopy] = []
        self._ending = threading.Event()
        self._deadline_s = math.inf
        self._thread = threading.Thread(target=self._run, name="log upload", daemon=True)

    def start(self) -> None:
        """Start the thread; the first upload comes after `INTERVAL_S`."""
        self._thread.start()

    def finish(self, patience_s: float, given_up: Callable[[], bool] = lambda: False) -> None:
        """Upload new lines for the last time, until `patience_s` is over or `given_up()`."""
        self._deadline_s = time.monotonic() + patience_s
        self._ending.set()
        while self._thread.is_alive() and not self._is_over() and not given_up():
            self._thread.join(_CHECK_S)
        left = sum(copy.left_bytes() for copy in self._copies)
        if left or self._thread.is_alive():
            how_much = f"{left / 1e6:,.1f} MB" if left else "The newest part"
            _logger.warning(
                "%s of the logs could not be uploaded in time and is in data/logs only. "
                "A start with --resume uploads it.",
                how_much,
            )

    def _run(self) -> None:
        while not self._ending.wait(INTERVAL_S):
            self._upload()
        self._upload()

    def _upload(self) -> None:
        try:
            if not self._copies:
                bucket = self._open_bucket()
                self._copies = [
                    LogCopy(bucket, key, path, self._max_bytes) for key, path in self._logs.items()
                ]
            for copy in self._copies:
                copy.update(self._is_over, hurried=self._ending.is_set())
        except DrError as error:
            _logger.warning("The logs could not be uploaded: %s", error)
        except OSError as error:
            _logger.warning("The logs could not be read: %s", error)

    def _is_over(self) -> bool:
        return time.monotonic() > self._deadline_s


def _folder(directory: Path, prefix: str, kind: str) -> Path:
    return directory / "data" / "logs" / kind / prefix


def _read_position(path: Path, log: Path) -> _Position:
    """The position where an earlier start stopped, or the beginning if it fits no file."""
    position = load_record(_Position, path)
    if position is None:
        return _Position()
    try:
        current = log_files.current_number(log)
        size = log.stat().st_size if position.number == current else math.inf
        if 1 <= position.number <= current and 0 <= position.offset <= size:
            return position
    except OSError:
        pass
    return _Position()


def _read(path: Path, offset: int) -> bytes:
    """Bytes from an offset on, at most one part."""
    with path.open("rb") as file:
        file.seek(offset)
        return file.read(PART_BYTES)


def _end_of(path: Path) -> bytes:
    """The last bytes of a file, at most one part."""
    return _read(path, max(0, path.stat().st_size - PART_BYTES))

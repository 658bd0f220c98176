"""Logging of a run's processes, with time (UTC) and level.

The file is also standard output and error, for C code and `faulthandler`. A thread rotates it: it
replaces all three descriptors between two records, so nothing is lost.
"""

import calendar
import json
import logging
import math
import os
import re
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from drcli.base.files import leads_to

# Log files of limited size.
#
# `sim-0.log` is the current file, `sim-0.log.part-0001` an older part,
# `sim-0.log.20261122-093000` of an earlier training. Only the current one ends in `.log`:
# log-guru fails at one that begins in the middle. `sim-0.jsonl` has JSON lines, `reward-0.log`
# what the racer's code printed.


VARIABLE = "DRCLI_LOG"
UPLOADED = ".uploaded"
"""Says how much is in the bucket."""

SENT = ".sent"
"""For a service that collects logs."""

EARLIER_TRAININGS = 3
_STAMP = "%Y%m%d-%H%M%S"
_WORKER = r"(?:(?:trainer|supervisor|sim-\d+)\.(?:log|jsonl)|reward-\d+\.log)"
_LOG = re.compile(rf"({_WORKER})(\.part-\d+)?")
_EARLIER = re.compile(rf"{_WORKER}\.(\d{{8}}-\d{{6}})(?:\.part-\d+)?")


def part_bytes(max_bytes: int) -> int:
    """Half of the log: tools read a single file."""
    return max_bytes // 2


def older_parts(log: Path) -> list[Path]:
    parts = log.parent.glob(f"{log.name}.part-*")
    return sorted((path for path in parts if path.name.rpartition("-")[2].isdigit()), key=number_of)


def number_of(part: Path) -> int:
    """From 1."""
    return int(part.name.rpartition(".part-")[2])


def current_number(log: Path) -> int:
    parts = older_parts(log)
    return number_of(parts[-1]) + 1 if parts else 1


def rotate(log: Path, max_bytes: int) -> int:
    """Begin a new file; returns its descriptor in append mode.

    Raises:
        OSError: The log has not changed.
    """
    fresh = log.with_name(f"{log.name}.new")
    descriptor = os.open(fresh, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_TRUNC, 0o666)
    try:
        log.rename(log.with_name(f"{log.name}.part-{current_number(log):04d}"))
        fresh.rename(log)
    except OSError:
        os.close(descriptor)
        raise
    _prune(older_parts(log), max_bytes - part_bytes(max_bytes))
    return descriptor


def set_aside(folders: list[Path], max_bytes: int) -> None:
    """Rename the logs of the last training.

    Earlier logs may have `max_bytes` for each worker; the newest stays.
    """
    stamp = _stamp(folders)
    for folder in folders:
        workers = set()
        for path in _files(folder):
            found = _LOG.fullmatch(path.name)
            if path.name.endswith((UPLOADED, SENT)):
                path.unlink()
            elif found:
                workers.add(found[1])
                path.rename(path.with_name(f"{found[1]}.{stamp}{found[2] or ''}"))
        _delete_earliest(folder, max_bytes * max(1, len(workers)))


def _delete_earliest(folder: Path, max_bytes: int) -> None:
    by_stamp: dict[str, list[Path]] = {}
    for path in _files(folder):
        found = _EARLIER.fullmatch(path.name)
        if found:
            by_stamp.setdefault(found[1], []).append(path)
    kept_bytes = 0
    for index, stamp in enumerate(sorted(by_stamp, reverse=True)):
        kept_bytes += sum(path.stat().st_size for path in by_stamp[stamp])
        if index and (index >= EARLIER_TRAININGS or kept_bytes > max_bytes):
            for path in by_stamp[stamp]:
                path.unlink(missing_ok=True)


def _stamp(folders: list[Path]) -> str:
    """Still the newest if the clock was set back."""
    found = (_EARLIER.fullmatch(path.name) for folder in folders for path in _files(folder))
    newest = max((match[1] for match in found if match), default="")
    now = time.strftime(_STAMP, time.gmtime())
    if now > newest:
        return now
    try:
        return time.strftime(
            _STAMP, time.gmtime(calendar.timegm(time.strptime(newest, _STAMP)) + 1)
        )
    except ValueError:  # no time at all, such as the 99th month
        return now


def _files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _prune(parts: list[Path], max_bytes: int) -> None:
    """The newest gives the next one its number."""
    sizes = [path.stat().st_size for path in parts]
    while len(parts) > 1 and sum(sizes) > max_bytes:
        with suppress(OSError):
            parts[0].unlink()
        parts, sizes = parts[1:], sizes[1:]


POLL_S = 0.1
_ours = logging.Manager(logging.RootLogger(logging.INFO))
"""Not Python's: a reward function may configure or switch off those."""


def get_logger(name: str) -> logging.Logger:
    """Silent without `LogFile`."""
    return _ours.getLogger(name)


plain = get_logger("plain")
"""As it is, for tools."""

traces = get_logger("plain.traces")
"""For the lines of every step."""


def event(logger: logging.Logger, kind: str, message: str, /, **facts: object) -> None:
    """A sentence for people, and facts for the JSON form."""
    logger.info("%s", message, extra={"event": kind, "facts": facts})


def add_handler(handler: logging.Handler) -> None:
    _ours.root.addHandler(handler)


def remove_handler(handler: logging.Handler) -> None:
    """Undo `add_handler`."""
    _ours.root.removeHandler(handler)


class LogFile(logging.FileHandler):
    """With older parts it has `max_bytes`."""

    def __init__(self, path: Path, max_bytes: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        super().__init__(path, encoding="utf-8", errors="backslashreplace")
        self.setFormatter(_Formatter())
        self._path = path
        self._max_bytes = max_bytes
        self._ending = threading.Event()
        add_handler(self)
        threading.Thread(target=self._keep_small, name="log rotation", daemon=True).start()

    def end(self) -> None:
        """Stop writing.

        Not `close`: Python calls that if a reward function configures `logging`, and this handler
        then opens its file again.
        """
        self._ending.set()
        remove_handler(self)
        with suppress(OSError):  # a full disk
            self.close()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  the name in `logging`
        if not isinstance(sys.exception(), OSError):
            super().handleError(record)

    def _keep_small(self) -> None:
        while not self._ending.wait(POLL_S):
            with suppress(OSError):  # the disk is full or the folder is gone; tried again later
                self._rotate_if_large()

    def _rotate_if_large(self) -> None:
        self.acquire()
        try:
            if not self.stream:  # closed
                return
            own = self.stream.fileno()
            if os.fstat(own).st_size < part_bytes(self._max_bytes):
                return
            writers = [each for each in (own, 1, 2) if leads_to(self._path, each)]
            if own not in writers:  # somebody has renamed or deleted the file
                return
            fresh = rotate(self._path, self._max_bytes)
            for each in writers:
                os.dup2(fresh, each, inheritable=each != own)
            os.close(fresh)
        finally:
            self.release()


class _Formatter(logging.Formatter):
    """2026-11-22T09:30:00.123Z INFO What happened."""

    default_time_format = "%Y-%m-%dT%H:%M:%S"
    default_msec_format = "%s.%03dZ"

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(message)s")
        self.converter = time.gmtime

    def format(self, record: logging.LogRecord) -> str:
        return record.getMessage() if is_plain(record) else super().format(record)


def record_text(record: logging.LogRecord) -> str:
    return _Formatter().format(record)


def is_plain(record: logging.LogRecord) -> bool:
    return record.name in (plain.name, traces.name)


# A text file of limited size.


LONGEST_LINE = 64 << 10


class RotatingFile:
    """Appends lines, from any thread; with older parts it has `max_bytes`.

    Each line is written at once. On a full disk, lines are lost.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._descriptor: int | None = None
        self._unfinished = ""
        self._lock = threading.Lock()

    def write(self, text: str) -> None:
        """The last, incomplete line waits."""
        with self._lock:
            text = self._unfinished + text
            end = len(text) if len(text) > LONGEST_LINE else text.rfind("\n") + 1
            self._unfinished = text[end:]
            if end:
                self._append(text[:end])

    def close(self) -> None:
        with self._lock:
            if self._unfinished:
                self._append(self._unfinished + "\n")
                self._unfinished = ""
            self._release()

    def _append(self, text: str) -> None:
        data = text.encode("utf-8", "backslashreplace")
        with suppress(OSError):  # a full disk, or a folder that is gone
            if self._descriptor is not None and not leads_to(self._path, self._descriptor):
                self._release()  # another process has rotated it, or somebody has deleted it
            if self._descriptor is None:
                self._open()
            assert self._descriptor is not None
            os.write(self._descriptor, data)
            if os.fstat(self._descriptor).st_size >= part_bytes(self._max_bytes):
                fresh = rotate(self._path, self._max_bytes)
                self._release()
                self._descriptor = fresh

    def _open(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
        self._descriptor = os.open(self._path, flags, 0o666)

    def _release(self) -> None:
        if self._descriptor is not None:
            with suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = None


# The log of a process as JSON lines.
#
# `time` (UTC, ISO 8601), `level`, `process` and `message`; for events also `event` and facts.
# Lines of every step are only in the trace.


PRINT = "print"
_OWN = ("time", "level", "process", "event", "message")


class RotatingLog(logging.Handler):
    """Writes into a file that, with older parts, has `max_bytes`."""

    def __init__(self, path: Path, max_bytes: int) -> None:
        super().__init__()
        self.file = RotatingFile(path, max_bytes)
        add_handler(self)

    def end(self) -> None:
        remove_handler(self)
        self.file.close()


class JsonLog(RotatingLog):
    def __init__(self, path: Path, max_bytes: int, process: str) -> None:
        self._process = process
        self._printed = ""
        self._printing = threading.Lock()
        super().__init__(path, max_bytes)

    def emit(self, record: logging.LogRecord) -> None:
        if record.name == traces.name:
            return
        try:
            message = record.getMessage()
            if record.exc_info:
                message += "\n" + "".join(traceback.format_exception(*record.exc_info)).rstrip()
            facts = getattr(record, "facts", {})
            self._write(
                record.created, record.levelname, getattr(record, "event", ""), message, facts
            )
        except Exception:  # as in every handler: a record that cannot be written ends nothing
            self.handleError(record)

    def printed(self, text: str) -> None:
        with self._printing:
            *lines, rest = (self._printed + text).split("\n")
            if len(rest) > LONGEST_LINE:
                lines, rest = [*lines, rest], ""
            self._printed = rest
        for line in lines:
            self._write(time.time(), "INFO", PRINT, line, {})

    def end(self) -> None:
        if self._printed:
            self.printed("\n")
        super().end()

    def _write(
        self, created_s: float, level: str, event: str, message: str, facts: Mapping[str, Any]
    ) -> None:
        if not message.strip():
            return
        record: dict[str, Any] = {"time": utc(created_s), "level": level, "process": self._process}
        if event:
            record["event"] = event
        record["message"] = message.strip("\n")
        record |= {name: _known(value) for name, value in facts.items() if name not in _OWN}
        self.file.write(json.dumps(record, allow_nan=False, default=str) + "\n")


def utc(at_s: float) -> str:
    """2026-11-22T09:30:00.123Z."""
    milliseconds = int(at_s * 1000)
    moment = time.gmtime(milliseconds // 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', moment)}.{milliseconds % 1000:03d}Z"


def _known(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {str(name): _known(item) for name, item in value.items()}
    return [_known(item) for item in value] if isinstance(value, list | tuple) else value

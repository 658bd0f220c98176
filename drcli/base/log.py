"""Logging of a run's processes, with time (UTC) and level.

The file is also standard output and error, for C code and `faulthandler`. A thread rotates it: it
replaces all three descriptors between two records, so nothing is lost.
"""

import logging
import os
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from drcli.base import log_files
from drcli.base.file_lock import leads_to

LOOK_S = 0.1
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
        while not self._ending.wait(LOOK_S):
            with suppress(OSError):  # the disk is full or the folder is gone; tried again later
                self._rotate_if_large()

    def _rotate_if_large(self) -> None:
        self.acquire()
        try:
            if not self.stream:  # closed
                return
            own = self.stream.fileno()
            if os.fstat(own).st_size < log_files.part_bytes(self._max_bytes):
                return
            writers = [each for each in (own, 1, 2) if leads_to(self._path, each)]
            if own not in writers:  # somebody has renamed or deleted the file
                return
            fresh = log_files.rotate(self._path, self._max_bytes)
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

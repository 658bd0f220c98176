"""A text file of limited size."""

import os
import threading
from contextlib import suppress
from pathlib import Path

from drcli.base import log_files
from drcli.base.file_lock import leads_to

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
            if os.fstat(self._descriptor).st_size >= log_files.part_bytes(self._max_bytes):
                fresh = log_files.rotate(self._path, self._max_bytes)
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

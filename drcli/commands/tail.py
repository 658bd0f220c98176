"""Reads the end of a log file and what is added to it."""

import os
from collections import deque
from pathlib import Path
from typing import BinaryIO


class Tail:
    """A log file from near its end on. It may come late, be replaced or be emptied.

    Args:
        path: The file.
        last_lines: How many of the lines that are there already to begin with; None for all. A
            file that comes later is read from its beginning.
    """

    def __init__(self, path: Path, last_lines: int | None = None) -> None:
        self._path = path
        self._last_lines = last_lines
        self._inode: int | None = None
        self._position = 0
        self._unfinished = b""

    def read(self, *, unfinished: bool = False) -> str:
        """Lines that were added since the last call.

        Args:
            unfinished: Whether a last line counts that has no end yet.
        """
        try:
            with self._path.open("rb") as file:
                added = self._added(file)
        except FileNotFoundError:
            self._last_lines = None
            return ""
        data = self._unfinished + added
        end = len(data) if unfinished else data.rfind(b"\n") + 1
        self._unfinished = data[end:]
        return data[:end].decode("utf-8", "replace")

    def _added(self, file: BinaryIO) -> bytes:
        state = os.fstat(file.fileno())
        if self._inode is None:
            data = b"".join(deque(file, self._last_lines))
        else:
            if state.st_ino != self._inode or state.st_size < self._position:
                self._position, self._unfinished = 0, b""
            file.seek(self._position)
            data = file.read()
        self._inode, self._position = state.st_ino, file.tell()
        return data

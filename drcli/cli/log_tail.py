"""Shows the end of a log file, and lines that are added later."""

import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from drcli.base import log_files
from drcli.cli import console

POLL_S = 0.3

_BLOCK_BYTES = 1 << 20

_MOST_BYTES = 16 << 20
"""Most bytes to read at once: a log may be larger than the free memory."""


def show_log(path: Path, last_lines: int | None, follow: Callable[[], bool]) -> None:
    """Print the last lines of a log, or all with None, and new lines while `follow` is true."""
    tail = Tail(path, last_lines)
    try:
        for piece in older(path) if last_lines is None else ():
            console.write(piece)
        while follow():
            text = tail.read()
            console.write(text, followed=True)
            if not text:
                time.sleep(POLL_S)
        while text := tail.read(unfinished=True):
            console.write(text)
    except KeyboardInterrupt:  # the usual way to end it
        return


class Tail:
    """Reads a log file that may appear later, be replaced or emptied.

    Args:
        path: The file.
        last_lines: Number of existing lines to begin with; None for all. A file that appears later
            is read from its beginning.
    """

    def __init__(self, path: Path, last_lines: int | None = None) -> None:
        self._path = path
        self._last_lines = last_lines
        self._file: BinaryIO | None = None
        self._unfinished = b""

    def read(self, *, unfinished: bool = False) -> str:
        """New lines, at most 16 MB; with `unfinished`, also a last line that has no end yet."""
        data = self._added()
        end = data.rfind(b"\n") + 1
        if len(data) < _MOST_BYTES:
            end = len(data) if unfinished else end
        elif end == 0:  # a line without an end
            end = len(data)
        self._unfinished = data[end:]
        return data[:end].decode("utf-8", "replace")

    def __del__(self) -> None:
        """Close the file, which stays open because it may be renamed before it is read."""
        if self._file is not None:
            self._file.close()

    def _added(self) -> bytes:
        """New bytes, after the part of a line that was read before."""
        if self._file is None:
            return self._begin()
        if os.fstat(self._file.fileno()).st_size < self._file.tell():
            self._file.seek(0)
            return self._file.read(_MOST_BYTES)
        data = self._unfinished + self._file.read(_MOST_BYTES)
        if len(data) >= _MOST_BYTES:
            return data
        try:
            if os.path.samestat(self._path.stat(), os.fstat(self._file.fileno())):
                return data
        except FileNotFoundError:  # a new one may appear
            return data
        # What was written between the read and the change of files is in the old file.
        data += self._file.read()
        self._file.close()
        self._last_lines = None
        return data[: data.rfind(b"\n") + 1] + self._begin()

    def _begin(self) -> bytes:
        try:
            if not self._path.is_file():  # to open a named pipe would wait for a writer
                raise FileNotFoundError
            self._file = self._path.open("rb")
        except FileNotFoundError:
            self._last_lines = None
            return b""
        if self._last_lines is None:
            return self._file.read(_MOST_BYTES)
        _seek_last_lines(self._file, self._last_lines)
        return b"".join(deque(self._file, self._last_lines))


def older(log: Path) -> Iterator[str]:
    """The rotated parts of a log, oldest first, in pieces; without the current file."""
    for part in log_files.older_parts(log):
        with part.open(encoding="utf-8", errors="replace", newline="") as file:
            while piece := file.read(_BLOCK_BYTES):
                yield piece


def _seek_last_lines(file: BinaryIO, count: int) -> None:
    """Go to a position with at least so many lines behind it, reading only from there."""
    position = file.seek(0, os.SEEK_END)
    found = 0
    while position and found <= count:
        size = min(_BLOCK_BYTES, position)
        position -= size
        file.seek(position)
        found += file.read(size).count(b"\n")
    file.seek(position)

"""Shows the end of a log file, and later lines."""

import os
import re
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import BinaryIO

from drcli.base import log as log_files
from drcli.cli import terminal

POLL_S = 0.3

_BLOCK_BYTES = 1 << 20

_MOST_BYTES = 16 << 20

_TIMED = re.compile(
    r'^(?:(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3})Z |\{"time": "(\d{4}-[^"]*)Z")', re.MULTILINE
)


def show_log(
    path: Path,
    last_lines: int | None,
    follow: Callable[[], bool],
    *,
    since: datetime | None = None,
) -> None:
    """Print the last lines of a log, or all, and new ones while `follow` is true."""
    whole = last_lines is None or since is not None
    tail = Tail(path, None if whole else last_lines)
    try:
        existing = chain(older(path, since) if whole else (), iter(tail.read, ""))
        for piece in chosen(existing, last_lines, since) if whole else ():
            terminal.write(piece)
        while follow():
            text = tail.read()
            terminal.write(text, followed=True)
            if not text:
                time.sleep(POLL_S)
        while text := tail.read(unfinished=True):
            terminal.write(text)
    except KeyboardInterrupt:  # the usual way to end it
        return


def chosen(pieces: Iterable[str], last_lines: int | None, since: datetime | None) -> Iterator[str]:
    if since is not None:
        pieces = _since(pieces, since)
    if last_lines is None:
        yield from pieces
        return
    kept = ""
    for piece in pieces:
        kept = "\n".join((kept + piece).split("\n")[-last_lines - 1 :])
    lines = kept.split("\n")
    surplus = len(lines) - last_lines - (not lines[-1])
    yield "\n".join(lines[max(0, surplus) :])


def _since(pieces: Iterable[str], since: datetime) -> Iterator[str]:
    limit = since.astimezone(UTC).isoformat(timespec="milliseconds")[:23]
    rest, found = "", False
    for piece in pieces:
        if found:
            yield piece
            continue
        text = rest + piece
        for match in _TIMED.finditer(text):
            if (match[1] or match[2]) >= limit:
                yield text[match.start() :]
                found = True
                break
        rest = text[text.rfind("\n") + 1 :]


class Tail:
    """Reads a log file that may appear later, be replaced or emptied."""

    def __init__(self, path: Path, last_lines: int | None = None) -> None:
        self._path = path
        self._last_lines = last_lines
        self._file: BinaryIO | None = None
        self._unfinished = b""

    def read(self, *, unfinished: bool = False) -> str:
        """New lines, at most 16 MB; `unfinished`: also one without an end."""
        data = self._added()
        end = data.rfind(b"\n") + 1
        if len(data) < _MOST_BYTES:
            end = len(data) if unfinished else end
        elif end == 0:  # a line without an end
            end = len(data)
        self._unfinished = data[end:]
        return data[:end].decode("utf-8", "replace")

    def __del__(self) -> None:
        """Kept open: it may be renamed before it is read."""
        if self._file is not None:
            self._file.close()

    def _added(self) -> bytes:
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


def older(log: Path, since: datetime | None = None) -> Iterator[str]:
    """The rotated parts of a log, oldest first."""
    for part in log_files.older_parts(log):
        if since is not None and part.stat().st_mtime < since.timestamp():
            continue
        with part.open(encoding="utf-8", errors="replace", newline="") as file:
            while piece := file.read(_BLOCK_BYTES):
                yield piece


def _seek_last_lines(file: BinaryIO, count: int) -> None:
    position = file.seek(0, os.SEEK_END)
    found = 0
    while position and found <= count:
        size = min(_BLOCK_BYTES, position)
        position -= size
        file.seek(position)
        found += file.read(size).count(b"\n")
    file.seek(position)

"""Reads what was added to a log, also after rotations and restarts."""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from drcli.base import log as log_files
from drcli.base.files import load_record, save_record
from drcli.base.json_record import SafeInt
from drcli.bucket.bucket import Bucket, ObjectInfo, ObjectMissing
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.run_record import log_kind


@dataclass
class Position:
    number: SafeInt = 1
    offset: SafeInt = 0


class UnreadLog:
    def __init__(self, log: Path, position_file: Path, most_bytes: int) -> None:
        self.log = log
        self._file = position_file
        self._most_bytes = most_bytes
        self.at = _read_position(position_file, log)

    def next_piece(self) -> tuple[Path | None, bytes]:
        """None if just rotated; OSError if it cannot be read."""
        at = self.at
        for part in log_files.older_parts(self.log):
            number = log_files.number_of(part)
            if number > at.number:  # files between were deleted because the log grew too large
                at = self.at = Position(number)
            if number == at.number:
                return part, read_piece(part, at.offset, self._most_bytes)
        data = read_piece(self.log, at.offset, self._most_bytes)
        current = log_files.current_number(self.log)
        if current < at.number:  # the older files were deleted
            self.at = Position(current)
        return (self.log if current == at.number else None), data

    def advance(self, read_bytes: int) -> None:
        self.at = Position(self.at.number, self.at.offset + read_bytes)

    def next_file(self) -> None:
        self.at = Position(self.at.number + 1)

    def save(self) -> None:
        with suppress(OSError):
            save_record(self._file, self.at)

    def left_bytes(self) -> int:
        left = -self.at.offset
        for path in [*log_files.older_parts(self.log), self.log]:
            with suppress(OSError):
                number = None if path == self.log else log_files.number_of(path)
                counts = number is None or number >= self.at.number
                left += path.stat().st_size if counts else 0
        return max(0, left)


def read_piece(path: Path, offset: int, most_bytes: int) -> bytes:
    with path.open("rb") as file:
        file.seek(offset)
        return file.read(most_bytes)


def _read_position(path: Path, log: Path) -> Position:
    position = load_record(Position, path)
    if position is None:
        return Position()
    try:
        current = log_files.current_number(log)
        size = log.stat().st_size if position.number == current else math.inf
        if 1 <= position.number <= current and 0 <= position.offset <= size:
            return position
    except OSError:
        pass
    return Position()


# Reads the copy of another machine's log in the bucket.


_KNOWN_BYTES = 4 << 10


@dataclass(frozen=True)
class UploadedLog:
    """As `run_logs.LogCopy` writes it."""

    bucket: Bucket
    key: str
    objects: tuple[ObjectInfo, ...]

    @property
    def uploaded(self) -> datetime:
        return max(info.modified for info in self.objects)

    def pieces(self, since: datetime | None = None) -> Iterator[bytes]:
        """Without objects that have only lines from before `since`."""
        return self._read([each for each in self.objects if since is None or each.modified > since])

    def last_lines(self, count: int) -> bytes:
        found = b""
        for piece in self._read(self.objects[::-1]):
            found = piece + found
            if found.count(b"\n") > count:
                break
        return b"".join(found.splitlines(keepends=True)[-count:]) if count else b""

    def _read(self, objects: Sequence[ObjectInfo]) -> Iterator[bytes]:
        for info in objects:
            try:
                yield self.bucket.get(info.key)
            except ObjectMissing:  # a log that has become too large loses its oldest parts
                continue


class UploadedTail:
    def __init__(self, bucket: Bucket, key: str, shown: bytes) -> None:
        self._bucket = bucket
        self._key = key
        self._shown = shown[-_KNOWN_BYTES:]
        self._objects: tuple[ObjectInfo, ...] = ()

    def read(self) -> bytes:
        """The whole log if it was begun anew."""
        found = find_objects(self._bucket, self._key)
        if found is None or found.objects == self._objects:
            return b""
        text = b""
        for info in reversed(found.objects):
            text = b"".join(UploadedLog(self._bucket, self._key, (info,)).pieces()) + text
            place = text.rfind(self._shown) if self._shown else -1
            if place >= 0:
                text = text[place + len(self._shown) :]
                break
        self._objects = found.objects
        self._shown = (self._shown + text)[-_KNOWN_BYTES:]
        return text


def find_uploaded(model: ModelStore, name: str, file: str) -> UploadedLog | None:
    return find_objects(model.bucket, keys.log(model.prefix, log_kind(name), file))


def find_objects(bucket: Bucket, key: str) -> UploadedLog | None:
    newest, parts = [], []
    for info in bucket.list(key.rpartition("/")[0] + "/"):
        number = keys.part_number(key, info.key)
        if number is not None:
            parts.append((number, info))
        elif info.key == key:
            newest.append(info)
    objects = [info for _, info in sorted(parts, key=lambda part: part[0])] + newest
    return UploadedLog(bucket, key, tuple(objects)) if objects else None


# Reads the end of a file as text.


_HEAD_SHARE = 16


def text_tail(path: Path, most_bytes: int) -> str:
    """Never a part of a line, which could be a part of a secret."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        if size <= most_bytes:
            return file.read(most_bytes).decode("utf-8", "replace")
        head = file.read(most_bytes // _HEAD_SHARE)
        head = head[: head.rfind(b"\n") + 1]
        file.seek(size - (most_bytes - len(head)))
        _, _, tail = file.read(most_bytes).partition(b"\n")
    left_out = size - len(head) - len(tail)
    note = f"(... {left_out:,} bytes were left out here ...)\n"
    return head.decode("utf-8", "replace") + note + tail.decode("utf-8", "replace")

"""Reads what was added to a log, also after rotations and restarts."""

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.base import log_files
from drcli.base.atomic_file import load_record, save_record


@dataclass
class Position:
    number: int = 1
    offset: int = 0


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

"""Repairs a damaged simtrace file, so that a strict reader can read what is left of it.

A disk that was full, a process that was killed and an editor leave half lines, empty files and
words where numbers belong. deepracer-utils, or pandas below it, stops at some of these and turns
whole columns into text at others.
"""

import csv
import io
import math
from collections.abc import Callable
from dataclasses import dataclass

WHOLE_COLUMNS = ("episode", "closest_waypoint")
"""Columns of whole numbers that every trace has."""

NUMBER_COLUMNS = ("steps", "X", "Y", "yaw", "steer", "throttle", "progress", "track_len", "tstamp")
"""Columns of finite numbers that every trace has."""

FLAG_COLUMNS = ("done", "all_wheels_on_track")

NEEDED = (*WHOLE_COLUMNS, *NUMBER_COLUMNS, *FLAG_COLUMNS, "action", "reward", "episode_status")

_LATER_NUMBERS = ("pause_duration", "wall_clock", "reward_ms")
"""Columns of numbers that older simulators do not write; an unreadable one is left empty."""

_FLAGS = {"True": "True", "False": "False", "true": "True", "false": "False", "1": "True"}
_FLAGS["0"] = "False"

_LARGEST = {"tstamp": 1e12, "episode": 1e9}


def largest(column: str) -> float:
    """The magnitude from which on a number in a column of a trace is damage.

    No place, angle, speed, step or waypoint of a car comes near a million. Times may be those of a
    wall clock, and episodes are counted over a whole training. A reward may be anything.
    """
    return _LARGEST.get(column, 1e6)


@dataclass(frozen=True)
class CleanTrace:
    """What is left of a trace.

    Attributes:
        data: The file without damaged rows; None if nothing is left.
        fault: What was wrong, to be read after the name of the file; None if nothing was.
        rows: How many rows are left.
    """

    data: bytes | None
    fault: str | None
    rows: int = 0


def clean(data: bytes) -> CleanTrace:
    """Leave out the rows of a simtrace that cannot be read.

    A reward that is not a finite number is kept as NaN: its step was driven.
    """
    if not data.strip(b"\0 \r\n\t"):
        return CleanTrace(None, "is empty")
    text = data.decode("utf-8-sig", "replace").replace("\0", "")
    lines = text.splitlines()
    header = [name.strip() for name in lines[0].split(",")]
    missing = [name for name in NEEDED if name not in header]
    if missing:
        named = ", ".join(missing[:3]) + (" ..." if len(missing) > 3 else "")
        return CleanTrace(None, f"is not a trace: its first line does not name {named}")
    if len(set(header)) < len(header):
        return CleanTrace(None, "is not a trace: its first line names a column twice")
    tidy = _row_reader(header)
    kept, damaged, first = [], 0, 0
    for number, fields in enumerate(_split(lines[1:]), start=2):
        row = tidy(fields)
        if row is not None:
            kept.append(row)
        elif any(fields):
            damaged += 1
            first = first or number
    if not kept:
        return CleanTrace(None, "has no readable row")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(kept)
    fault = None
    if damaged:
        rows = "a damaged row" if damaged == 1 else f"{damaged:,} damaged rows, the first"
        fault = f"has {rows} in line {first}"
    return CleanTrace(out.getvalue().encode(), fault, len(kept))


def _split(lines: list[str]) -> list[list[str]]:
    """Fields of each line. Traces have no quotes, so a stray one is damage of its line only."""
    return [line.split(",") for line in lines]


def _row_reader(header: list[str]) -> Callable[[list[str]], list[str] | None]:
    """A function that returns a row as it is to be read, or None if that cannot be done."""
    at = {name: place for place, name in enumerate(header)}
    wholes = [(at[name], largest(name)) for name in WHOLE_COLUMNS]
    numbers = [(at[name], largest(name)) for name in NUMBER_COLUMNS]
    flags = [at[name] for name in FLAG_COLUMNS]
    later = [at[name] for name in _LATER_NUMBERS if name in at]
    action, reward, status = at["action"], at["reward"], at["episode_status"]

    def tidy(fields: list[str]) -> list[str] | None:
        if len(fields) == len(header) + 1 and fields[action].startswith("["):
            # A continuous action that was written as Python writes a list, with a comma.
            fields[action : action + 2] = [f"{fields[action]} {fields[action + 1].strip()}"]
        if len(fields) != len(header):
            return None
        if not all(_is_whole(fields[i], limit) for i, limit in wholes):
            return None
        if not all(_is_finite(fields[i], limit) for i, limit in numbers):
            return None
        for i in flags:
            fields[i] = _FLAGS.get(fields[i].strip(), "")
            if not fields[i]:
                return None
        if not fields[status].strip() or not fields[status].isascii():
            return None
        if not _is_finite(fields[reward]):
            fields[reward] = "nan"
        for i in later:
            if not _is_finite(fields[i]):
                fields[i] = "nan"
        for i, _ in wholes:
            fields[i] = str(int(float(fields[i])))
        return fields

    return tidy


def _is_finite(text: str, limit: float = math.inf) -> bool:
    """Whether a text is a number of a smaller magnitude than the limit."""
    try:
        return abs(float(text)) < limit and "_" not in text
    except ValueError:
        return False


def _is_whole(text: str, limit: float) -> bool:
    return _is_finite(text, limit) and float(text).is_integer() and float(text) >= 0

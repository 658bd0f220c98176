"""Repairs a damaged simtrace file, so that a strict reader can read what is left of it.

A disk that was full, a process that was killed and an editor leave half lines, empty files and
words where numbers belong. deepracer-utils, or pandas below it, stops at some of these and turns
whole columns into text at others.
"""

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass

from drcli.exchange.trace_rows import COLUMNS, TraceRow, number_or_nan, read_rows

_UNTOLD = ("episode_status", "pause_duration", "obstacle_crash_counter", "wall_clock")
"""Columns that older simulators do not write."""

NEEDED = tuple(name for name in COLUMNS if name not in _UNTOLD)

_WRITTEN = tuple(name for name in COLUMNS if name != "obstacle_crash_counter")


@dataclass(frozen=True)
class CleanTrace:
    """What is left of a trace.

    Attributes:
        data: The file without damaged rows; None if nothing is left.
        fault: What was wrong, to be read after the name of the file; None if nothing was.
    """

    data: bytes | None
    fault: str | None


def clean(data: bytes) -> CleanTrace:
    """Leave out the rows of a simtrace that cannot be read.

    A reward that is not a finite number is kept as NaN: its step was driven.
    """
    if not data.strip(b"\0 \r\n\t"):
        return CleanTrace(None, "is empty")
    found = read_rows(data)
    missing = [name for name in NEEDED if name not in found.names]
    if missing:
        named = ", ".join(missing[:3]) + (" ..." if len(missing) > 3 else "")
        return CleanTrace(None, f"is not a trace: its first line does not name {named}")
    if len(set(found.names)) < len(found.names):
        return CleanTrace(None, "is not a trace: its first line names a column twice")
    if not found.rows:
        return CleanTrace(None, "has no readable row")
    fault = None
    if found.damaged:
        number = len(found.damaged)
        rows = "a damaged row" if number == 1 else f"{number:,} damaged rows, the first"
        fault = f"has {rows} in line {found.damaged[0]}"
    more = [name for name in found.names if name not in COLUMNS]
    return CleanTrace(written(found.rows, more), fault)


def written(rows: Iterable[TraceRow], more: Iterable[str] = ()) -> bytes:
    """Rows as a simtrace that deepracer-utils reads; `more` names the columns of their `more`."""
    more = list(more)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_WRITTEN, *more])
    for row in rows:
        cells = row._asdict()
        del cells["line"], cells["more"]
        own = [
            number_or_nan(each) if name == "reward_ms" else each
            for name, each in zip(more, row.more, strict=True)
        ]
        writer.writerow([*cells.values(), *own])
    return text.getvalue().encode()

"""Repairs a damaged simtrace file for strict readers.

A full disk or a killed process leaves half lines, empty files and words where numbers belong.
deepracer-utils (pandas) stops at some, and turns whole columns into text at others.
"""

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass

from drcli.exchange.trace_rows import COLUMNS, TraceRow, number_or_nan, read_rows

_UNTOLD = ("episode_status", "pause_duration", "obstacle_crash_counter", "wall_clock")
NEEDED = tuple(name for name in COLUMNS if name not in _UNTOLD)

_WRITTEN = tuple(name for name in COLUMNS if name != "obstacle_crash_counter")


@dataclass(frozen=True)
class CleanTrace:
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
    """Rows as a simtrace; `more` names further columns."""
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

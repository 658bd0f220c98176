"""Reads the rows of a trace, whoever wrote it: a simtrace CSV, or the trace lines of a log.

A CSV names its columns; a log line has those of `COLUMNS` after `SIM_TRACE_LOG:`, maybe after a
time or inside JSON. Simulators of 2019 end with `tstamp`, write radians, and number a reset's step
0. Later ones append status, penalty, crashes, then wall clock. A continuous action is `[steering
speed]`, or a Python list, bare or in quotes.

Sources: the simulators' format strings, and deepracer-utils, which takes the crashes of a line with
18 fields for its wall clock.
"""

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import NamedTuple

COLUMNS = (
    *("episode", "steps", "X", "Y", "yaw", "steer", "throttle", "action", "reward", "done"),
    *("all_wheels_on_track", "progress", "closest_waypoint", "track_len", "tstamp"),
    *("episode_status", "pause_duration", "obstacle_crash_counter", "wall_clock"),
)
"""Of the reference simulator, version 6."""

LOG_MARK = "SIM_TRACE_LOG:"
_FIELDS_OF_2019 = 15
_FIELDS_WITHOUT_CLOCK = 18

_QUOTE = r'(?:\\?")?'
_LIST = re.compile(rf"{_QUOTE}\[([^\]]*)\]{_QUOTE}")
_IN_LOG = re.compile(rf"{LOG_MARK}((?:{_QUOTE}\[[^\]]*\]{_QUOTE}|[-+\w., ])*)")

_FLAGS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}

_LARGEST = {"tstamp": 1e12, "episode": 1e9}

_YEAR_2001_S = 1e9
"""More is a wall clock, not a number of crashes."""

_MOST_RAD = (3.2, 1.0)
"""Heading and steering, if all angles are radians."""


def largest(column: str) -> float:
    """The magnitude from which a number in a column is damage.

    No place, angle, speed, step or waypoint comes near a million.
    """
    return _LARGEST.get(column, 1e6)


class TraceRow(NamedTuple):
    """A step. NaN, None, -1 and empty texts: the file has no such column.

    Attributes:
        x: Of the point 0.14 m ahead of the origin, metres; so is `y`.
        yaw_deg: In [-180, 180].
        steering_deg: Requested, left positive.
        action: Index, or "[steering speed]".
        status: Lowercase; else what the row shows.
        pause_s: Rest of a penalty.
        wall_s: Unix time.
        more: Columns that the reference lacks.
    """

    line: int
    episode: int
    steps: float
    x: float
    y: float
    yaw_deg: float
    steering_deg: float
    speed_mps: float
    action: str
    reward: float
    done: bool
    on_track: bool | None
    progress: float
    closest_waypoint: int
    track_length_m: float
    time_s: float
    status: str
    pause_s: float
    wall_s: float
    more: tuple[str, ...] = ()


@dataclass
class TraceRows:
    names: tuple[str, ...] = ()
    rows: list[TraceRow] = field(default_factory=list)
    damaged: list[int] = field(default_factory=list)


def read_rows(data: bytes) -> TraceRows:
    """Leaves out lines with any damage."""
    text = _text(data)
    lines = text.splitlines()
    in_log = LOG_MARK in text
    found = TraceRows()
    if in_log:
        found.names = COLUMNS
    elif lines:
        found.names = tuple(_fields(lines[0]) or ())
    # A number that was cut off still looks like one: the end of an unfinished line is not trusted.
    unfinished = 0 if text.endswith(("\n", "\r")) else len(lines)
    for number, fields in (_in_log if in_log else _in_table)(lines, unfinished):
        cells = _cells(fields, found.names, in_log=in_log)
        row = None if cells is None else _row(number, cells)
        if row is not None:
            found.rows.append(row)
        elif fields is None or any(fields):
            found.damaged.append(number)
    if any(not row.status for row in found.rows):
        found.rows = list(_told(found.rows, "episode_status" in found.names and not in_log))
    return found


def _text(data: bytes) -> str:
    """Windows' shells write logs in UTF-16."""
    utf_16 = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    return data.decode("utf-16" if utf_16 else "utf-8-sig", "replace").replace("\0", "")


def _in_log(lines: Sequence[str], unfinished: int) -> Iterator[tuple[int, list[str] | None]]:
    for number, line in enumerate(lines, 1):
        for match in _IN_LOG.finditer(line):
            is_cut = number == unfinished and match.end() == len(line)
            yield number, None if is_cut else _fields(match[1])


def _in_table(lines: Sequence[str], unfinished: int) -> Iterator[tuple[int, list[str] | None]]:
    for number, line in enumerate(lines[1:], 2):
        yield number, None if number == unfinished else _fields(line)


def _fields(line: str) -> list[str] | None:
    """An action keeps its blank; None if its quotes have no end."""
    if "[" in line:
        line = _LIST.sub(lambda found: f"[{' '.join(found[1].replace(',', ' ').split())}]", line)
    if '"' not in line:
        return [each.strip() for each in line.split(",")]
    try:
        return [each.strip() for each in next(csv.reader([line], strict=True))]
    except csv.Error:
        return None


def _cells(
    fields: Sequence[str] | None, names: Sequence[str], *, in_log: bool
) -> dict[str, str] | None:
    if fields is None or len(fields) < (_FIELDS_OF_2019 if in_log else len(names)):
        return None
    if not in_log and len(fields) > len(names):
        return None
    cells = dict(zip(names, fields, strict=False))
    if in_log and len(fields) == _FIELDS_WITHOUT_CLOCK and number_or_nan(fields[-1]) > _YEAR_2001_S:
        cells["wall_clock"] = fields[-1]
    return cells


def _row(line: int, cells: Mapping[str, str]) -> TraceRow | None:
    action = cells.get("action", "")
    steering, speed = cells.get("steer", ""), cells.get("throttle", "")
    pair = action.strip("[]").split()
    if not (steering and speed) and len(pair) == 2:
        steering, speed = pair
    asked = {"steer": steering, "throttle": speed} if steering or "steer" in cells else {}
    status = cells.get("episode_status", "").casefold()
    try:
        row = TraceRow(
            line=line,
            episode=_whole(cells, "episode", 0),
            steps=_number(cells, "steps"),
            x=_number(cells, "X"),
            y=_number(cells, "Y"),
            yaw_deg=_number(cells, "yaw"),
            steering_deg=_number(asked, "steer"),
            speed_mps=_number(asked, "throttle"),
            action=action,
            reward=number_or_nan(cells.get("reward", "")),
            done=_FLAGS[cells.get("done", "0").casefold()],
            on_track=_FLAGS[cells["all_wheels_on_track"].casefold()]
            if "all_wheels_on_track" in cells
            else None,
            progress=_number(cells, "progress"),
            closest_waypoint=_whole(cells, "closest_waypoint", -1),
            track_length_m=_number(cells, "track_len"),
            time_s=_number(cells, "tstamp"),
            status=status,
            pause_s=number_or_nan(cells.get("pause_duration", "")),
            wall_s=number_or_nan(cells.get("wall_clock", "")),
            more=tuple(cells[name] for name in cells if name not in COLUMNS),
        )
    except (ValueError, KeyError):
        return None
    return row if status.isascii() else None


def _number(cells: Mapping[str, str], name: str) -> float:
    if name not in cells:
        return math.nan
    value = float(cells[name])
    if not abs(value) < largest(name) or "_" in cells[name]:
        raise ValueError(name)
    return value


def _whole(cells: Mapping[str, str], name: str, otherwise: int) -> int:
    if name not in cells:
        return otherwise
    value = _number(cells, name)
    if value < 0 or not value.is_integer():
        raise ValueError(name)
    return int(value)


def number_or_nan(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def _told(rows: Sequence[TraceRow], has_column: bool) -> Iterator[TraceRow]:
    """With a status where none was written, and angles in degrees."""
    old = [row for row in rows if not row.status]
    most_yaw, most_steering = _MOST_RAD
    in_radians = not has_column and all(
        abs(row.yaw_deg) <= most_yaw and abs(row.steering_deg) <= most_steering for row in old
    )
    before = -1
    for row, after in zip_longest(rows, rows[1:]):
        told = row
        if not row.status:
            first = before != row.episode and row.steps <= 1.0
            goes_on = after is not None and after.episode == row.episode
            told = row._replace(status=_status(row, prepares=first and goes_on))
            if in_radians:
                yaw, steering = math.degrees(row.yaw_deg), math.degrees(row.steering_deg)
                told = told._replace(yaw_deg=yaw, steering_deg=steering)
        before = row.episode
        yield told


def _status(row: TraceRow, *, prepares: bool) -> str:
    if row.done:
        ended = "immobilized" if row.on_track else "off_track"
        return "lap_complete" if row.progress >= 100.0 else ended
    return "prepare" if prepares else "in_progress"

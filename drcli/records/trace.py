"""Driven episodes as rows: simtrace CSV and SIM_TRACE_LOG lines.

Analysis tools define both formats: names, order, decimals and spelling.
"""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, zip_longest
from typing import Literal, NamedTuple

# Reads the rows of a trace, whoever wrote it: a simtrace CSV, or the trace lines of a log.
#
# A CSV names its columns; a log line has those of `COLUMNS` after `SIM_TRACE_LOG:`, maybe after a
# time or inside JSON. Simulators of 2019 end with `tstamp`, write radians, and number a reset's
# step 0. Later ones append status, penalty, crashes, then wall clock. A continuous action is
# `[steering speed]`, or a Python list, bare or in quotes.
#
# Sources: the simulators' format strings, and deepracer-utils, which takes the crashes of a line
# with 18 fields for its wall clock.


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
    in_log = LOG_MARK in text
    lines = text.splitlines() if in_log else _with_commas(text.splitlines())
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


def _with_commas(lines: list[str]) -> list[str]:
    """Tables as spreadsheets save them: with ; or tabs, maybe with decimal commas."""
    separator = next((mark for mark in ";\t" if lines and mark in lines[0]), "")
    if not separator or "," in lines[0]:
        return lines
    return [line.replace(",", ".").replace(separator, ",") for line in lines]


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


CSV_HEADER = ",".join([*COLUMNS, "reward_ms"])
"""Only the last column is ours."""

STATUS_LABELS = {
    "lap_complete": "Lap complete",
    "off_track": "Off track",
    "crashed": "Crashed",
    "immobilized": "Immobilized",
    "reversed": "Reversed",
    "in_progress": "In progress",
    "pause": "Pause",
    "prepare": "Prepare",
    "park": "Park",
    "time_up": "Time Up",
    "discarded": "Discarded",
}
VIOLATIONS = ("crashed", "immobilized", "off_track", "reversed")
STEP_S = 1.0 / 15.0
"""Simulated time of one step, seconds.

Rows are stamped at the end of their step; the first, `prepare`, is the step of the reset. So an
episode begins a step before its first row, as in the reference's metrics. In a race without a stop,
a later lap begins at the last row of the one before.
"""

Phase = Literal["training", "evaluation"]


@dataclass(frozen=True, slots=True)
class Row:
    """One step of one car.

    Attributes:
        steps: From 1, `prepare`.
        x: Of the point 0.14 m ahead of the origin, metres; so is `y`.
        yaw_deg: In [-180, 180].
        steering_deg: Requested, left positive.
        speed_mps: Requested.
        action: Index, or "[steering speed]".
        status: A key of `STATUS_LABELS`.
        pause_s: Rest of a penalty.
        time_s: Simulated, since the reset.
        reward_ms: Wall time of the reward function, so not compared.
    """

    steps: int
    x: float
    y: float
    yaw_deg: float
    steering_deg: float
    speed_mps: float
    action: str
    reward: float
    done: bool
    all_wheels_on_track: bool
    progress: float
    closest_waypoint: int
    status: str
    pause_s: float
    time_s: float
    crashes: int = 0
    reward_ms: float = field(default=0.0, compare=False)


@dataclass
class Episode:
    """A whole episode, from `prepare` to its end.

    Attributes:
        number: From 0; trials begin at 0 again.
        clock_s: Simulation clock at its reset, as if episodes followed one another.
        track_length_m: Of the centre line.
    """

    number: int
    phase: Phase
    rows: list[Row] = field(default_factory=list)
    clock_s: float = 0.0
    begin_s: float = 0.0
    track_length_m: float = 0.0

    @property
    def reward(self) -> float:
        return sum(row.reward for row in self.rows)

    @property
    def progress(self) -> float:
        return self.rows[-1].progress

    @property
    def status(self) -> str:
        return self.rows[-1].status

    @property
    def completed(self) -> bool:
        return self.status == "lap_complete"

    @property
    def discarded(self) -> bool:
        """Declared broken by the reward function: not learned from."""
        return self.status == "discarded"

    @property
    def duration_s(self) -> float:
        return self.rows[-1].time_s - self.begin_s

    @property
    def steps(self) -> int:
        return len(self.rows) - 1


def steering_changes(episodes: Iterable[Episode]) -> tuple[int, float]:
    """Changes of the steering's side (straight is not one), and metres."""
    changes, metres = 0, 0.0
    for episode in episodes:
        side = 0.0
        for before, row in pairwise(episode.rows):
            metres += math.hypot(row.x - before.x, row.y - before.y)
            if row.steering_deg:
                changes += side * row.steering_deg < 0.0
                side = math.copysign(1.0, row.steering_deg)
    return changes, metres


def schedule(episodes: Iterable[Episode], clock_s: float) -> float:
    """Set `clock_s` of parallel episodes as if one followed the other."""
    for episode in episodes:
        episode.clock_s = clock_s
        clock_s += episode.duration_s + STEP_S
    return clock_s


def csv_text(episodes: Iterable[Episode], wall_clock: tuple[float, float]) -> str:
    """A simtrace file.

    Cars drive in parallel, so the rows share the `wall_clock` (Unix seconds) equally: analysis
    tools then compute the right real-time factor.
    """
    rows = [(episode, row) for episode in episodes for row in episode.rows]
    begin, end = wall_clock
    per_row = (end - begin) / max(len(rows), 1)
    lines = [
        ",".join(_csv_fields(episode, row, begin + per_row * (i + 1)))
        for i, (episode, row) in enumerate(rows)
    ]
    return "\n".join([CSV_HEADER, *lines, ""])


def _csv_fields(episode: Episode, row: Row, wall_clock: float) -> list[str]:
    return [
        str(episode.number),
        f"{float(row.steps)}",
        str(row.x),
        str(row.y),
        str(row.yaw_deg),
        str(row.steering_deg),
        str(row.speed_mps),
        row.action,
        str(row.reward),
        str(row.done),
        str(row.all_wheels_on_track),
        str(row.progress),
        str(row.closest_waypoint),
        str(episode.track_length_m),
        str(episode.clock_s + row.time_s),
        row.status,
        str(row.pause_s),
        str(row.crashes),
        str(wall_clock),
        str(round(row.reward_ms, 3)),
    ]


def log_lines(episode: Episode, wall_clock: float) -> str:
    return "\n".join(
        f"{LOG_MARK}{episode.number},{row.steps},{row.x:.4f},{row.y:.4f},{row.yaw_deg:.4f},"
        f"{row.steering_deg:.2f},{row.speed_mps:.2f},{row.action},{row.reward:.4f},{row.done},"
        f"{row.all_wheels_on_track},{_progress(row)},{row.closest_waypoint},"
        f"{episode.track_length_m:.2f},{episode.clock_s + row.time_s},{row.status},"
        f"{row.pause_s:.2f},{row.crashes},{wall_clock:.4f}"
        for row in episode.rows
    )


def _progress(row: Row) -> str:
    """Never 0.0000 at the end of an episode: log-guru divides by it."""
    text = f"{row.progress:.4f}"
    return "0.0001" if row.done and float(text) == 0.0 else text


@dataclass(frozen=True)
class TracedEpisode:
    """As `Episode`, from a simtrace; `wall_s` is Unix time of its first and last row."""

    number: int
    steps: int
    reward: float
    progress: float
    status: str
    clock_s: float
    duration_s: float
    wall_s: tuple[float, float]
    phase: Phase = "training"


def read_csv(data: bytes) -> list[TracedEpisode]:
    episodes: dict[int, list[TraceRow]] = {}
    for row in read_rows(data).rows:
        if math.isfinite(row.reward + row.wall_s) and row.status in STATUS_LABELS:
            episodes.setdefault(row.episode, []).append(row)
    return [
        TracedEpisode(
            number=number,
            steps=len(rows) - 1,
            reward=sum(row.reward for row in rows),
            progress=rows[-1].progress,
            status=rows[-1].status,
            clock_s=rows[0].time_s - STEP_S,
            duration_s=rows[-1].time_s - rows[0].time_s + STEP_S,
            wall_s=(rows[0].wall_s, rows[-1].wall_s),
        )
        for number, rows in episodes.items()
        if len(rows) > 1
    ]

"""Reads the steps of a training from its simulation log, for archives that have no traces.

deepracer-utils reads the lines (`SimulationLogsIO`); what is ours is to leave out damaged ones,
which stop it.
"""

import io
import re
from typing import TYPE_CHECKING

from drcli.analysis.clean_trace import largest
from drcli.analysis.extra import deepracer_logs
from drcli.analysis.model_source import ModelSource
from drcli.analysis.read_traces import TraceReading, packed
from drcli.base.errors import DrError

if TYPE_CHECKING:
    import pandas as pd

_LOG = re.compile(r"logs/(?:training|robomaker)/[^/]+\.log(?:\.\d+)?")

_LEAST_FIELDS = 16

_NUMBERS = {
    **{0: "episode", 1: "steps", 2: "X", 3: "Y", 4: "yaw", 5: "steer", 6: "throttle", 8: "reward"},
    **{11: "progress", 12: "closest_waypoint", 13: "track_len", 14: "tstamp"},
}
"""Places of the fields that must be numbers within the limits of a trace, and their columns there;
any reward will do."""


def read_console_log(
    source: ModelSource, episodes_per_iteration: int, problems: list[str]
) -> TraceReading:
    """The steps of the newest training log; none if there is no such log."""
    names = sorted(name for name in source.files.others if _LOG.fullmatch(name))
    reading = TraceReading()
    if not names:
        return reading
    # A log that was rolled over continues the one with the next number.
    newest = re.sub(r"\.\d+$", "", names[-1])
    parts = sorted((n for n in names if n.startswith(f"{newest}.")), key=_part)
    lines: list[str] = []
    damaged = 0
    for name in [*parts, *([newest] if newest in names else [])]:
        try:
            text = source.objects.read(source.files.others[name]).decode("utf-8", "replace")
        except DrError as error:
            problems.append(f"{name} cannot be read: {error}")
            continue
        found, bad = _trace_lines(text)
        lines += found
        damaged += bad
    if damaged:
        problems.append(f"{newest}: {damaged:,} damaged lines with steps were left out.")
    if lines:
        reading.steps = _steps(lines, episodes_per_iteration)
    return reading


def _part(name: str) -> int:
    return int(name.rpartition(".")[2])


def _trace_lines(text: str) -> tuple[list[str], int]:
    """The steps in a log, as the library's parser takes them, and how many lines are damaged."""
    logs = deepracer_logs().SimulationLogsIO
    marked = (line for line in text.splitlines() if "SIM_TRACE_LOG:" in line)
    found = [line for each in marked for line in logs.load_buffer(io.StringIO(each))]
    whole = [line for line in found if _is_whole(line)]
    return whole, len(found) - len(whole)


def _is_whole(line: str) -> bool:
    fields = line.rstrip().split(",")
    if len(fields) < _LEAST_FIELDS:
        return False
    try:
        values = {name: float(fields[place]) for place, name in _NUMBERS.items()}
        wholes = [int(fields[place]) for place in (0, 1, 12)]
        later = [float(field) for field in fields[16:19]]
    except ValueError:
        return False
    within = all(abs(value) < largest(name) for name, value in values.items() if name != "reward")
    return within and min(wholes) >= 0 and len(later) >= 0


def _steps(lines: list[str], episodes_per_iteration: int) -> "pd.DataFrame":
    logs = deepracer_logs().SimulationLogsIO
    frame = logs.convert_to_pandas(lines, episodes_per_iteration)
    frame["worker"] = 0
    return packed(frame)

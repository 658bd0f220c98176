"""Reads the steps of training and evaluation traces, with the column names of deepracer-utils.

- Of all files at once, with the widest types, two million steps take 1.9 GB. So files are read in
  batches, and columns with few values are packed after each.
- A damaged file stops pandas, or turns columns into text. So `clean` repairs it first.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from drcli.analysis.model_source import ModelSource, Trace
from drcli.analysis.run import Numbers, deepracer_logs, spans
from drcli.base.errors import DrError
from drcli.base.installation import lazy_imports
from drcli.records.trace import COLUMNS, STEP_S, TraceRow, largest, number_or_nan, read_rows

with lazy_imports():
    import pandas as pd
    from pandas.api import types

# Repairs a damaged simtrace file for strict readers.
#
# A full disk or a killed process leaves half lines, empty files and words where numbers belong.
# deepracer-utils (pandas) stops at some, and turns whole columns into text at others.


_UNTOLD = ("episode_status", "pause_duration", "obstacle_crash_counter", "wall_clock")
NEEDED = tuple(name for name in COLUMNS if name not in _UNTOLD)

_WRITTEN = tuple(name for name in COLUMNS if name != "obstacle_crash_counter")


def clean(data: bytes) -> tuple[bytes | None, str | None]:
    """Leave out the rows of a simtrace that cannot be read.

    A reward that is not a finite number is kept as NaN: its step was driven.

    Returns:
        What can be read, and what is wrong with the file.
    """
    if not data.strip(b"\0 \r\n\t"):
        return None, "is empty"
    found = read_rows(data)
    missing = [name for name in NEEDED if name not in found.names]
    if missing:
        named = ", ".join(missing[:3]) + (" ..." if len(missing) > 3 else "")
        return None, f"is not a trace: its first line does not name {named}"
    if len(set(found.names)) < len(found.names):
        return None, "is not a trace: its first line names a column twice"
    if not found.rows:
        return None, "has no readable row"
    fault = None
    if found.damaged:
        number = len(found.damaged)
        rows = "a damaged row" if number == 1 else f"{number:,} damaged rows, the first"
        fault = f"has {rows} in line {found.damaged[0]}"
    more = [name for name in found.names if name not in COLUMNS]
    return written(found.rows, more), fault


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


FILES_PER_BATCH = 24

STEP_COLUMNS = (
    *("episode", "steps", "x", "y", "yaw", "steering_angle", "speed", "action", "reward", "done"),
    *("on_track", "progress", "closest_waypoint", "track_len", "tstamp", "episode_status"),
    *("pause_duration", "wall_clock", "iteration", "worker"),
)
_PACKED = {
    "episode": "int32",
    "steps": "int32",
    "action": "int16",
    "closest_waypoint": "int32",
    "iteration": "int32",
    "worker": "int16",
    "yaw": "float32",
    "track_len": "float32",
    "pause_duration": "float32",
}
_MOST_TOLD = 8


@dataclass
class TraceReading:
    steps: "pd.DataFrame | None" = None
    problems: list[str] = field(default_factory=list)


def read_traces(files: Sequence[Trace], read: Callable[[str], bytes]) -> TraceReading:
    """Read traces of one training or evaluation, in their order; a DrError becomes a problem."""
    reading = TraceReading()
    batches = []
    for start in range(0, len(files), FILES_PER_BATCH):
        frame = _batch(files[start : start + FILES_PER_BATCH], read, reading)
        if frame is not None:
            # One by one: a frame keeps columns of the same type in one array, all or nothing.
            batches.append({name: frame[name].copy() for name in frame.columns})
    if batches:
        reading.steps = _joined(batches)
    told = len(reading.problems) - _MOST_TOLD
    if told > 1:
        reading.problems[_MOST_TOLD:] = [f"{told} more traces are damaged in such a way."]
    return reading


def _batch(
    files: Sequence[Trace], read: Callable[[str], bytes], reading: TraceReading
) -> "pd.DataFrame | None":
    data: dict[Trace, bytes] = {}
    for file in files:
        try:
            data[file] = read(file.name)
        except DrError as error:
            reading.problems.append(f"{file.name} cannot be read: {error}")
    frame = _by_pandas(data) if all(map(_looks_whole, data.values())) else None
    if frame is None or not _is_sound(frame):
        frame = _by_pandas(_repaired(data, reading))
    return None if frame is None else packed(frame)


def _looks_whole(data: bytes) -> bool:
    """Whether the first row has as many fields as the header, and the last one an end.

    Else pandas takes the first column for names of rows, and shifts the rest.
    """
    header, _, rest = data.partition(b"\n")
    row = rest.partition(b"\n")[0]
    fits = bool(row) and header.count(b",") == row.count(b",")
    return fits and data.endswith(b"\n") and b"\0" not in data


def _repaired(data: Mapping[Trace, bytes], reading: TraceReading) -> dict[Trace, bytes]:
    found = {}
    for file, content in data.items():
        readable, fault = clean(content)
        if readable is not None:
            found[file] = readable
        if fault is not None:
            rest = "It is left out" if readable is None else "The other rows are analysed"
            reading.problems.append(f"{file.name} {fault}. {rest}.")
    return found


_RENAMED = {
    "X": "x",
    "Y": "y",
    "steer": "steering_angle",
    "throttle": "speed",
    "all_wheels_on_track": "on_track",
}


def _by_pandas(data: Mapping[Trace, bytes]) -> "pd.DataFrame | None":
    frames = []
    try:
        for file, content in data.items():
            frame = pd.read_csv(io.BytesIO(content), low_memory=False)
            if not types.is_numeric_dtype(frame["action"]):
                frame["action"] = -1  # continuous
            frames.append(frame.assign(iteration=file.iteration, worker=file.worker))
        joined = pd.concat(frames, ignore_index=True)
    except Exception:  # whatever pandas stumbles over: the files are damaged, or there are none
        return None
    joined = joined.rename(columns=_RENAMED).drop(columns="obstacle_crash_counter", errors="ignore")
    for name in {"wall_clock", "pause_duration"}.difference(joined):  # in very old traces
        joined[name] = math.nan
    return joined


def _is_sound(frame: "pd.DataFrame") -> bool:
    if not set(STEP_COLUMNS) <= set(frame.columns):
        return False
    for name in STEP_COLUMNS:
        column = frame[name]
        if name in ("done", "on_track"):
            sound = types.is_bool_dtype(column)
        elif name == "episode_status":
            sound = not types.is_numeric_dtype(column) and bool(column.notna().all())
        elif name in ("pause_duration", "wall_clock", "reward"):
            sound = types.is_numeric_dtype(column) and not types.is_bool_dtype(column)
        elif name in ("episode", "closest_waypoint"):
            sound = types.is_integer_dtype(column) and bool(column.between(0, largest(name)).all())
        else:
            sound = types.is_numeric_dtype(column) and _is_within(column, largest(name))
        if not sound:
            return False
    if "reward_ms" in frame and not types.is_numeric_dtype(frame["reward_ms"]):
        return False
    return bool((frame["action"] < 32_000).all())


def _is_within(column: "pd.Series", limit: float) -> bool:
    return bool((np.abs(column.to_numpy(dtype=np.float64)) < limit).all())


def packed(frame: "pd.DataFrame") -> "pd.DataFrame":
    frame = frame.astype(_PACKED)
    for name in frame.columns:
        if name not in STEP_COLUMNS and frame[name].dtype == "float64":
            frame[name] = frame[name].astype("float32")
    frame["episode_status"] = frame["episode_status"].astype("category")
    ours = [name for name in frame.columns if name not in STEP_COLUMNS]
    return frame[[*STEP_COLUMNS, *ours]]


def _joined(batches: "list[dict[str, pd.Series]]") -> "pd.DataFrame":
    """Each column is given up as soon as it is copied."""
    labels: dict[str, None] = {}
    for batch in batches:
        labels |= dict.fromkeys(batch["episode_status"].cat.categories)
    for batch in batches:
        batch["episode_status"] = batch["episode_status"].cat.set_categories(list(labels))
    columns: dict[str, None] = {}
    for batch in batches:
        columns |= dict.fromkeys(batch)
    rows = [len(batch["episode"]) for batch in batches]
    joined = {}
    for name in columns:
        parts = [
            batch.pop(name) if name in batch else _unknown(count)
            for batch, count in zip(batches, rows, strict=True)
        ]
        joined[name] = pd.concat(parts, ignore_index=True)
    return pd.DataFrame(joined, copy=False)


def _unknown(count: int) -> "pd.Series":
    return pd.Series(float("nan"), index=range(count), dtype="float32")


# Reads the steps of a training from its simulation logs.


_FILE = re.compile(r"(?P<log>.+?\.log)(?:\.(?P<start>\d{8}-\d{6}))?(?:\.(?:part-)?(?P<part>\d+))?")
_TRAINER = re.compile(
    r"logs/(?:.+/)?(?:sagemaker/[^/]+|[^/]*(?:sagemaker|trainer|-training\.)[^/]*)"
)
_SIMULATION = re.compile(r"logs/(?:training|robomaker)/[^/]+")
_WORKER = re.compile(r"logs/robomaker/(sim-\d+|joined-.+)\.log")


def trainer_logs(names: Iterable[str]) -> list[list[str]]:
    """The parts of each log of the trainer, the oldest start first."""
    return _starts(name for name in names if _TRAINER.fullmatch(name))


def simulation_logs(names: Iterable[str]) -> list[list[str]]:
    logs = (name for name in names if _SIMULATION.fullmatch(name))
    return _starts(name for name in logs if not _TRAINER.fullmatch(name))


def _starts(names: Iterable[str]) -> list[list[str]]:
    # What was moved away is older: the log of an earlier start, and the first parts of a long one.
    found = sorted(
        (match["log"], match["start"] or "~", float(match["part"] or math.inf), name)
        for name in names
        if (match := _FILE.fullmatch(name))
    )
    return [[each[-1] for each in start] for _, start in groupby(found, lambda each: each[:2])]


def read_console_log(
    source: ModelSource, episodes_per_iteration: int, problems: list[str]
) -> TraceReading:
    """The steps in all simulation logs.

    Each log of ours is of one worker. Others are starts of one worker: where episodes are counted
    from the beginning again, the iterations follow those before.
    """
    logs = simulation_logs(source.files.others)
    workers = list(dict.fromkeys(_worker(log) for log in logs))
    share = max(1, episodes_per_iteration // max(1, len(workers)))
    contents: dict[Trace, bytes] = {}
    for number, worker in enumerate(workers):
        starts = [_rows(source, log, problems) for log in logs if _worker(log) == worker]
        for iteration, rows in _iterations(starts, share):
            contents[Trace(f"{worker}, iteration {iteration}", number, iteration)] = written(rows)
    files = sorted(contents, key=lambda file: (file.iteration, file.worker))
    by_name = {file.name: content for file, content in contents.items()}
    return read_traces(files, by_name.__getitem__)


def _worker(log: list[str]) -> str:
    match = _FILE.fullmatch(log[0])
    own = match and _WORKER.fullmatch(match["log"])
    return own[1] if own else "the log"


def _rows(source: ModelSource, log: list[str], problems: list[str]) -> list[TraceRow]:
    data = b""
    for name in log:
        try:
            data += source.objects.read(source.files.others[name])
        except DrError as error:
            problems.append(f"{name} cannot be read: {error}")
    found = read_rows(data)
    if found.damaged:
        problems.append(
            f"{log[-1]}: {len(found.damaged):,} damaged lines with steps were left out."
        )
    return found.rows


def _iterations(
    starts: Iterable[list[TraceRow]], share: int
) -> Iterator[tuple[int, list[TraceRow]]]:
    found: dict[int, list[TraceRow]] = {}
    begin, before = 0, -1
    for rows in starts:
        for row in rows:
            if row.episode == 0 < before:
                begin = max(found) + 1
            found.setdefault(begin + row.episode // share, []).append(row)
            before = row.episode
    yield from found.items()


# Numbers the episodes of all workers, and makes a row for each.


EPISODE_COLUMNS = (
    *("iteration", "worker", "episode", "steps", "start_at", "progress", "time", "dist"),
    *("reward", "speed", "complete", "status", "quintile"),
)


def number_episodes(steps: "pd.DataFrame") -> "tuple[pd.DataFrame, list[str]]":
    """Sort steps by iteration, worker, episode and step, and number the episodes from 0.

    The numbers are those of deepracer-utils (`DeepRacerLog.load_training_trace`) if its rule, which
    takes the number of episodes from iteration 0, gives each its own; else without a gap.

    Returns:
        The steps with the column `unique_episode`, and sentences on what was wrong.
    """
    names = ("steps", "episode", "worker", "iteration")
    order = np.lexsort([steps[name].to_numpy() for name in names])
    if (np.diff(order) < 0).any():
        steps = steps.take(order).reset_index(drop=True)
    problems = []
    columns = [steps[name].to_numpy() for name in ("iteration", "worker", "episode")]
    new = np.zeros(len(steps), bool)
    new[0] = True
    for column in columns:
        new[1:] |= column[1:] != column[:-1]
    twice = ~new & np.concatenate([[False], np.diff(steps["steps"].to_numpy()) == 0])
    if twice.any():
        problems.append(
            f"{int(twice.sum()):,} steps are there twice, the first in iteration "
            f"{int(columns[0][twice.argmax()])}; each is counted once."
        )
        keep = ~twice
        steps = steps[keep].reset_index(drop=True)
        columns = [column[keep] for column in columns]
        new = new[keep]
    numbers = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    usual = _as_the_library(*(column[first].astype(np.int64) for column in columns))
    if usual is None:
        problems.append(
            "The numbers of the episodes do not fit those of iteration 0, so the episodes are "
            "numbered anew, in their order."
        )
    else:
        numbers = usual[numbers]
    steps["unique_episode"] = pd.Series(numbers, dtype="int32")
    return steps, problems


def _as_the_library(
    iteration: Numbers,
    worker: Numbers,
    episode: Numbers,
) -> Numbers | None:
    most = int(worker.max()) + 1
    share = np.zeros(most, np.int64)
    of_first = iteration == 0
    np.maximum.at(share, worker[of_first], episode[of_first] + 1)
    if not share.all():
        return None
    before = np.concatenate([[0], np.cumsum(share)[:-1]])
    numbers = episode % share[worker] + before[worker] + iteration * share.sum()
    if not (np.diff(numbers) > 0).all() or numbers[-1] >= 2**31:
        return None
    return np.asarray(numbers)


def episode_table(steps: "pd.DataFrame") -> "pd.DataFrame":
    """A row for each episode; index unique_episode.

    Most numbers are those of deepracer-utils (`AnalysisUtils.simulation_agg`): progress is the
    greatest of all steps, and the distance is summed from the first row on.
    """
    found = aggregated(steps, "unique_episode")
    _, last = spans(steps["unique_episode"].to_numpy())
    ends = steps.iloc[last]
    table = pd.DataFrame(
        {
            "iteration": found["iteration"],
            "worker": ends["worker"].to_numpy(),
            "episode": ends["episode"].to_numpy(),
            "steps": found["steps"].astype(int),
            "start_at": found["start_at"],
            "progress": found["progress"],
            "time": found["time"],
            "dist": found["dist"],
            "reward": found["reward"],
            "speed": found["speed"],
            "complete": found["complete"].astype(bool),
            "status": ends["episode_status"].astype(str).to_numpy(),
            "quintile": found["quintile"],
        }
    )
    table.index = pd.Index(found["unique_episode"], name="unique_episode")
    return table


def aggregated(steps: "pd.DataFrame", group: str, *, is_eval: bool = False) -> "pd.DataFrame":
    """The aggregates of deepracer-utils, a row for each (iteration, `group`).

    But the time is that of the metrics: it counts the step of the `prepare` row, which the library
    leaves out.
    """
    analysis = deepracer_logs().AnalysisUtils
    names = ["iteration", group, "steps", "x", "y", "speed", "reward", "progress"]
    frame = steps[[*names, "closest_waypoint", "tstamp"]].copy()
    status = steps["episode_status"]
    if not is_eval:
        frame["new_reward"] = 0.0  # the library prints a line if it has to add this itself
        first, _ = spans(steps[group].to_numpy())
        if "prepare" not in status.cat.categories:
            status = status.cat.add_categories("prepare")
        status = status.copy()
        # An episode whose first row was damaged would begin at the end of the one before.
        status.iloc[first] = "prepare"
    frame["episode_status"] = status
    found = analysis.simulation_agg(frame, secondgroup=group, is_eval=is_eval)
    keys = ["iteration", group]
    prepared = pd.MultiIndex.from_frame(steps.loc[(status == "prepare").to_numpy(), keys])
    found["time"] += STEP_S * pd.MultiIndex.from_frame(found[keys]).isin(prepared)
    return found

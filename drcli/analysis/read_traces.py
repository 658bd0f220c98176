"""Reads the steps of training and evaluation traces, by deepracer-utils.

It takes 5 s of processor time for two million steps (Xeon model 167). What it gets wrong:

- It reads all files at once, with the widest types: two million steps take 1.9 GB. So it gets
  batches, and columns with few values are packed after each.
- A damaged file stops it, or turns columns into text. So `clean_trace` repairs it first.
- Its numbering of episodes fails without iteration 0, or if that is shorter than others. So
  `number_episodes` repeats the rule where it works.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from drcli.analysis.clean_trace import clean
from drcli.analysis.extra import deepracer_logs
from drcli.base.errors import DrError
from drcli.exchange.trace_rows import largest

if TYPE_CHECKING:
    import pandas as pd

FILES_PER_BATCH = 24

COLUMNS = (
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


@dataclass(frozen=True)
class TraceFile:
    name: str
    worker: int
    iteration: int


@dataclass
class TraceReading:
    steps: "pd.DataFrame | None" = None
    unreadable: list[TraceFile] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def read_traces(files: Sequence[TraceFile], read: Callable[[str], bytes]) -> TraceReading:
    """Read traces of one training or one evaluation, in their order; a DrError becomes a problem.

    Raises:
        NotAvailable: The extra is not installed.
    """
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
    files: Sequence[TraceFile], read: Callable[[str], bytes], reading: TraceReading
) -> "pd.DataFrame | None":
    data: dict[TraceFile, bytes] = {}
    for file in files:
        try:
            data[file] = read(file.name)
        except DrError as error:
            reading.unreadable.append(file)
            reading.problems.append(f"{file.name} cannot be read: {error}")
    frame = _by_library(data) if all(map(_looks_whole, data.values())) else None
    if frame is None or not _is_sound(frame):
        frame = _by_library(_repaired(data, reading))
    return None if frame is None else packed(frame)


def _looks_whole(data: bytes) -> bool:
    """Whether the first row has as many fields as the header, and the last one an end.

    Else pandas takes the first column for names of rows, and shifts the rest.
    """
    header, _, rest = data.partition(b"\n")
    row = rest.partition(b"\n")[0]
    fits = bool(row) and header.count(b",") == row.count(b",")
    return fits and data.endswith(b"\n") and b"\0" not in data


def _repaired(data: Mapping[TraceFile, bytes], reading: TraceReading) -> dict[TraceFile, bytes]:
    found = {}
    for file, content in data.items():
        result = clean(content)
        if result.data is None:
            reading.unreadable.append(file)
            reading.problems.append(f"{file.name} {result.fault}. It is left out.")
            continue
        found[file] = result.data
        if result.fault is not None:
            reading.problems.append(f"{file.name} {result.fault}. The other rows are analysed.")
    return found


def _by_library(data: Mapping[TraceFile, bytes]) -> "pd.DataFrame | None":
    logs = deepracer_logs()
    if not data:
        return None
    content = {
        f"{number}/{file.worker}/training-simtrace/{file.iteration}-iteration.csv": content
        for number, (file, content) in enumerate(data.items())
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            log = logs.DeepRacerLog(filehandler=_handler(content))
            # In several threads, it is no faster here, and keeps memory in the heap of each.
            log._MAX_JOBS = 1
            log.load_training_trace(ignore_metadata=True)
            return log.dataframe()
    except Exception:  # whatever pandas or the library stumble over: the files are damaged
        return None


def _handler(content: Mapping[str, bytes]) -> Any:
    from deepracer.logs.handler import FileHandler
    from deepracer.logs.misc import LogFolderType

    class Handler(FileHandler):  # type: ignore[misc]
        type = LogFolderType.DRFC_MODEL_MULTIPLE_WORKERS
        training_simtrace_path = "training-simtrace"
        training_simtrace_split = r"(\d+)/training-simtrace/(\d+)-iteration\.csv$"

        def list_files(self, filterexp: str | None = None, check_exist: bool = False) -> list[str]:
            return list(content)

        def get_file(self, key: str) -> bytes:
            return content[key]

        def determine_root_folder_type(self) -> Any:
            return self.type

    return Handler()


def _is_sound(frame: "pd.DataFrame") -> bool:
    from pandas.api import types

    if not set(COLUMNS) <= set(frame.columns):
        return False
    for name in COLUMNS:
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
    import numpy as np

    return bool((np.abs(column.to_numpy(dtype=np.float64)) < limit).all())


def packed(frame: "pd.DataFrame") -> "pd.DataFrame":
    frame = frame.drop(columns=["unique_episode"], errors="ignore").astype(_PACKED)
    for name in frame.columns:
        if name not in COLUMNS and frame[name].dtype == "float64":
            frame[name] = frame[name].astype("float32")
    frame["episode_status"] = frame["episode_status"].astype("category")
    ours = [name for name in frame.columns if name not in COLUMNS]
    return frame[[*COLUMNS, *ours]]


def _joined(batches: "list[dict[str, pd.Series]]") -> "pd.DataFrame":
    """Each column is given up as soon as it is copied."""
    import pandas as pd

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
    import pandas as pd

    return pd.Series(float("nan"), index=range(count), dtype="float32")

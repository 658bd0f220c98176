"""Reads the steps of a training from its simulation logs."""

import math
import re
from collections.abc import Iterable, Iterator
from itertools import groupby

from drcli.analysis.clean_trace import written
from drcli.analysis.model_source import ModelSource
from drcli.analysis.read_traces import TraceFile, TraceReading, read_traces
from drcli.base.errors import DrError
from drcli.exchange.trace_rows import TraceRow, read_rows

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
    contents: dict[TraceFile, bytes] = {}
    for number, worker in enumerate(workers):
        starts = [_rows(source, log, problems) for log in logs if _worker(log) == worker]
        for iteration, rows in _iterations(starts, share):
            contents[TraceFile(f"{worker}, iteration {iteration}", number, iteration)] = written(
                rows
            )
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

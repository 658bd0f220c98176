"""Reads metrics, the learning curve and learner.csv.

`TrainingMetrics` of deepracer-utils reads a bucket only, gives the episodes of all workers the
iteration of worker 0, and stops at an empty list.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

from drcli.analysis.model_source import ModelSource
from drcli.analysis.read_log import trainer_logs
from drcli.base.errors import DrError
from drcli.base.json_record import RecordError
from drcli.exchange.episode_metrics import EpisodeMetrics, decode_metrics, most_episodes
from drcli.exchange.iteration import IterationRecord, decode_history
from drcli.exchange.trace import STATUS_LABELS

if TYPE_CHECKING:
    import pandas as pd

R = TypeVar("R", EpisodeMetrics, IterationRecord)

RECORD_COLUMNS = (
    *("phase", "iteration", "worker", "episode", "reward", "progress", "time", "complete"),
    "status",
)

_METRICS = re.compile(r"(?:metrics/)?TrainingMetrics(?:_(\d+))?\.json")
_CONSOLE_METRICS = re.compile(r"metrics/training/[^/]+\.json")
_POLICY_LINE = re.compile(
    r"Policy training> Surrogate loss=(\S+), KL divergence=(\S+), Entropy=(\S+), "
    r"training epoch=(\d+), learning_rate=(\S+)"
)

_LOG_BYTES = 64 << 20
_STATUS_OF = {label: status for status, label in STATUS_LABELS.items()}

_LEARNER_NAMES = {
    "losses/clipfrac": "clip_fraction",
    "losses/approx_kl": "kl",
    "charts/learning_rate": "learning_rate",
}
_CURVE_NAMES = {
    "entropy": "entropy",
    "kl": "kl",
    "surrogate_loss": "policy_loss",
    "value_loss": "value_loss",
    "actor_loss": "actor_loss",
    "critic_loss": "qf_loss",
    "alpha": "alpha",
    "imitation_loss": "imitation_loss",
    "learn_s": "update_s",
    "drive_s": "drive_s",
    "exchange_s": "exchange_s",
    "steps_per_s": "steps_per_s",
}


def metric_records(source: ModelSource, problems: list[str]) -> "pd.DataFrame":
    """A row for each episode in the metrics, in both phases."""
    import pandas as pd

    by_worker: dict[int, list[EpisodeMetrics]] = {}
    for name, real in source.files.others.items():
        match = _METRICS.fullmatch(name)
        if match is None and not _CONSOLE_METRICS.fullmatch(name):
            continue
        worker = int(match[1] or 0) if match else 0
        records = _records(source, real, problems)
        by_worker[worker] = by_worker.get(worker, []) + records
    per_iteration = most_episodes(by_worker.get(0, [])) or 1
    rows = [
        _row(record, worker, per_iteration if worker == 0 else _share(records, per_iteration))
        for worker, records in sorted(by_worker.items())
        for record in records
    ]
    return pd.DataFrame(rows, columns=list(RECORD_COLUMNS))


def _share(records: Sequence[EpisodeMetrics], of_first: int) -> int:
    """Episodes per iteration; `trial` never restarts in old files."""
    return of_first if any(r.iteration is None for r in records) else most_episodes(records) or 1


def _row(record: EpisodeMetrics, worker: int, per_iteration: int) -> tuple[Any, ...]:
    iteration = record.iteration
    if iteration is None:
        iteration = max(0, record.episode - 1) // per_iteration
    status = _STATUS_OF.get(record.episode_status, record.episode_status)
    return (
        record.phase,
        iteration,
        worker,
        record.episode,
        float(record.reward_score),
        float(record.completion_percentage),
        record.elapsed_time_in_milliseconds / 1000.0,
        record.episode_status == STATUS_LABELS["lap_complete"],
        status,
    )


def _records(source: ModelSource, name: str, problems: list[str]) -> list[EpisodeMetrics]:
    return _decoded(source, name, decode_metrics, problems)


def _decoded(
    source: ModelSource, name: str, decode: Callable[[bytes], list[R]], problems: list[str]
) -> list[R]:
    try:
        return decode(source.objects.read_whole(name))
    except RecordError as error:
        problems.append(f"{name} is damaged: {error}. It is left out.")
    except DrError as error:
        problems.append(f"{name} cannot be read: {error}")
    return []


def learning_curve(source: ModelSource, problems: list[str]) -> list[IterationRecord]:
    """The learning curve; empty for models of others."""
    name = source.files.others.get("metrics/history.json")
    return [] if name is None else _decoded(source, name, decode_history, problems)


def learner_table(
    source: ModelSource, curve: Sequence[IterationRecord], problems: list[str]
) -> "pd.DataFrame":
    """A row for each update."""
    import pandas as pd

    rows: dict[int, dict[str, float]] = {}
    for record in curve:
        values = {ours: getattr(record, name) for name, ours in _CURVE_NAMES.items()}
        rows[record.iteration] = {k: v for k, v in values.items() if v is not None}
    for iteration, values in _learner_csv(source, problems).items():
        rows[iteration] = {**values, **rows.get(iteration, {})}
    if not rows:
        rows = _trainer_logs(source)
    frame = pd.DataFrame.from_dict(rows, orient="index").sort_index()
    frame.index.name = "iteration"
    return frame.astype(float).dropna(axis="columns", how="all")


def _learner_csv(source: ModelSource, problems: list[str]) -> dict[int, dict[str, float]]:
    name = source.files.others.get("metrics/learner.csv")
    if name is None:
        return {}
    found: dict[int, dict[str, float]] = {}
    try:
        text = source.objects.read_whole(name).decode("utf-8", "replace")
        for row in csv.DictReader(io.StringIO(text, newline="")):
            iteration = _number(row.pop("iteration", None))
            if math.isfinite(iteration):
                found[int(iteration)] = {
                    _column(title): number
                    for title, cell in row.items()
                    if title and "/" in title and math.isfinite(number := _number(cell))
                }
    except (csv.Error, DrError) as error:
        problems.append(f"{name} cannot be read: {error}")
    return found


def _column(title: str) -> str:
    return _LEARNER_NAMES.get(title, title.rpartition("/")[2])


def _trainer_logs(source: ModelSource) -> dict[int, dict[str, float]]:
    rows: dict[int, dict[str, float]] = {}
    iteration, last_epoch = -1, math.inf
    for name in chain.from_iterable(trainer_logs(source.files.others)):
        try:
            data = source.objects.read(source.files.others[name])
        except DrError:
            continue
        for match in _POLICY_LINE.finditer(data[:_LOG_BYTES].decode("utf-8", "replace")):
            epoch = int(match[4])
            iteration += epoch <= last_epoch
            last_epoch = epoch
            names = ("policy_loss", "kl", "entropy", "learning_rate")
            cells = (match[1], match[2], match[3], match[5])
            rows[iteration] = dict(zip(names, map(_number, cells), strict=True))
    return rows


def _number(text: str | None) -> float:
    try:
        return float((text or "").rstrip(","))
    except ValueError:
        return math.nan

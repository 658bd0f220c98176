"""A model's traces in the bucket, and what is known without reading them."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

from drcli.base.errors import DrError, SettingsError
from drcli.base.json_record import RecordError, plain
from drcli.bucket.bucket import ObjectInfo
from drcli.config.run_config import ModelConfig
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_history
from drcli.model.traces import models_in
from drcli.records.episode_metrics import decode_metrics_file
from drcli.records.iteration import IterationRecord

TraceKind = Literal["training", "evaluation", "opponent"]

_PART = r"(?!\.+/)[A-Za-z0-9._-]+/"

_NAMES: tuple[tuple[TraceKind, re.Pattern[str]], ...] = (
    (
        "training",
        re.compile(
            r"(?:(?P<worker>[0-9]{1,3})/)?training-simtrace/(?P<n>[0-9]{1,9})-iteration\.csv"
        ),
    ),
    (
        "training",
        re.compile(
            rf"sim-trace/training/(?:{_PART})?training-simtrace/(?P<n>[0-9]{{1,9}})-iteration\.csv"
        ),
    ),
    (
        "evaluation",
        re.compile(
            rf"(?:sim-trace/evaluation/|evaluation-)(?P<stamp>{_PART})"
            r"evaluation-simtrace/(?P<n>[0-9]{1,9})-iteration\.csv"
        ),
    ),
    ("opponent", re.compile(r"evaluation-simtrace/(?P<n>[0-9]{1,9})-iteration\.csv")),
)
"""In all layouts: ours, DeepRacer-for-Cloud, the consoles."""

_BELOW_MODEL = re.compile(
    r"(.+?)/(?:(?:[0-9]{1,3}/)?training-simtrace|sim-trace/(?:training|evaluation)/.*"
    r"|evaluation-[^/]+/evaluation-simtrace|evaluation-simtrace)/[0-9]{1,9}-iteration\.csv"
)

MOST_EVALUATIONS = 40
"""Whose metrics are read for the list."""


@dataclass(frozen=True)
class StoredTrace:
    """One trace; null where unknown.

    Attributes:
        name: Key below the model.
        iteration: Of a training, else the file's number.
        stamp: Of an evaluation: fourteen digits, or its folder's name.
        mean_reward: Of all workers.
        mean_progress: Likewise, percent.
        best_lap_s: Of clean laps.
        clean_laps: Of an evaluation.
    """

    name: str
    kind: TraceKind
    worker: int
    iteration: int
    stamp: str
    size_bytes: int
    modified: float
    mean_reward: float | None = None
    mean_progress: float | None = None
    full_laps: int | None = None
    best_lap_s: float | None = None
    clean_laps: int | None = None
    resets: int | None = None


@dataclass(frozen=True)
class StoredTraces:
    """By iteration and worker, then the evaluations."""

    model: str
    traces: list[StoredTrace]
    notes: list[str]


def models_with_traces(listed: Iterable[ObjectInfo]) -> list[str]:
    """Prefixes of models, and of folders with traces only, which other programs leave."""
    listed = list(listed)
    found = set(models_in(listed))
    known = tuple(keys.folder(prefix) for prefix in found)
    for info in listed:
        match = _BELOW_MODEL.fullmatch(info.key)
        if match is not None and not info.key.startswith(known):
            found.add(match[1])
    return sorted(prefix for prefix in found if keys.is_valid_prefix(prefix))


def trace_key(prefix: str, name: str) -> str:
    """Raises SettingsError for wrong names."""
    if not keys.is_valid_prefix(prefix):
        raise SettingsError(
            f"{prefix[:80]!r} is no name of a model.", remedy="Choose a model of the list."
        )
    if parse_name(name) is None:
        raise SettingsError(
            f"{name[:80]!r} is no trace of a model.",
            remedy="Choose an iteration or an evaluation of the list.",
        )
    return keys.folder(prefix) + name


def parse_name(name: str) -> StoredTrace | None:
    for kind, pattern in _NAMES:
        found = pattern.fullmatch(name)
        if found is not None:
            groups = found.groupdict()
            stamp = (groups.get("stamp") or "").rstrip("/")
            return StoredTrace(
                name, kind, int(groups.get("worker") or 0), int(found["n"]), stamp, 0, 0.0
            )
    return None


def stored_traces(model: ModelStore, config: ModelConfig) -> StoredTraces:
    """All traces of a model, with numbers from its curve and metrics.

    Raises:
        SettingsError: The model's name is wrong, or it has none.
        StorageError: The bucket cannot be read.
    """
    if not keys.is_valid_prefix(model.prefix):
        raise SettingsError(
            f"{model.prefix[:80]!r} is no name of a model.", remedy="Choose a model of the list."
        )
    folder = keys.folder(model.prefix)
    listed = model.bucket.list(folder)
    if not listed:
        raise SettingsError(
            f"There is no model {model.prefix} in s3://{model.bucket.name}.",
            remedy="Choose a model of the list; `dr-list-models` shows all.",
        )
    inner = tuple(keys.folder(other) for other in models_in(listed) if other != model.prefix)
    own = [info for info in listed if not info.key.startswith(inner)]
    traces = [
        replace(found, size_bytes=info.size_bytes, modified=info.modified.timestamp())
        for info in own
        if (found := parse_name(info.key.removeprefix(folder))) is not None
    ]
    notes: list[str] = []
    records: dict[int, IterationRecord] = {}
    try:
        history, told = readable_history(ModelStore.of(config, model.bucket, model.prefix))
        records, notes = {record.iteration: record for record in history}, list(told)
    except DrError as error:
        notes.append(str(error))
    traces = [_with_record(trace, records.get(trace.iteration)) for trace in traces]
    stamps = sorted({trace.stamp for trace in traces if trace.kind == "evaluation"})
    store = ModelStore.of(config, model.bucket, model.prefix)
    numbers = _evaluation_numbers(store, stamps[-MOST_EVALUATIONS:], notes)
    traces = [
        replace(trace, **numbers.get(trace.stamp, {})) if trace.kind == "evaluation" else trace
        for trace in traces
    ]
    order = [kind for kind, _ in _NAMES]
    traces.sort(
        key=lambda each: (
            order.index(each.kind),
            each.stamp,
            each.iteration,
            each.worker,
            each.name,
        )
    )
    return StoredTraces(model.prefix, traces, notes)


def _with_record(trace: StoredTrace, record: IterationRecord | None) -> StoredTrace:
    if trace.kind != "training" or record is None:
        return trace
    return replace(
        trace,
        mean_reward=plain(record.mean_reward),
        mean_progress=plain(record.mean_progress),
        full_laps=record.full_laps,
        best_lap_s=record.best_lap_s,
    )


def _evaluation_numbers(
    model: ModelStore, stamps: Iterable[str], notes: list[str]
) -> dict[str, dict[str, Any]]:
    folder = keys.evaluation_metrics_folder(model.metrics_prefix)
    there = {info.key for info in model.bucket.list(folder)}
    found: dict[str, dict[str, Any]] = {}
    for stamp in stamps:
        key = f"{folder}evaluation-{stamp}.json"
        if key not in there:
            continue
        try:
            read = decode_metrics_file(model.bucket.get(key))
        except RecordError:
            notes.append(f"s3://{model.bucket.name}/{key} is damaged: it has no readable trials.")
            continue
        if read:
            clean_s = [t.elapsed_time_in_milliseconds / 1000.0 for t in read if t.clean]
            found[stamp] = {
                "mean_progress": sum(trial.completion_percentage for trial in read) / len(read),
                "full_laps": sum(trial.completion_percentage >= 100.0 for trial in read),
                "best_lap_s": min(clean_s, default=None),
                "clean_laps": len(clean_s),
                "resets": sum(trial.reset_count for trial in read),
            }
    return found

"""Reads metrics, the learning curve and learner.csv.

`TrainingMetrics` of deepracer-utils reads a bucket only, gives the episodes of all workers the
iteration of worker 0, and stops at an empty list.
"""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from drcli.analysis.model_source import ModelSource, Trace
from drcli.analysis.read_traces import STEP_COLUMNS, aggregated, read_traces, trainer_logs
from drcli.analysis.run import StoredEvaluation, spans
from drcli.base.errors import DrError
from drcli.base.installation import lazy_imports
from drcli.base.json_record import RecordError
from drcli.records.episode_metrics import EpisodeMetrics, decode_metrics, is_clean, most_episodes
from drcli.records.iteration import IterationRecord, decode_history, is_clean_lap
from drcli.records.trace import STATUS_LABELS, VIOLATIONS

with lazy_imports():
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
    by_worker: dict[int, list[EpisodeMetrics]] = {}
    for name, real in source.files.others.items():
        match = _METRICS.fullmatch(name)
        if match is None and not _CONSOLE_METRICS.fullmatch(name):
            continue
        worker = int(match[1] or 0) if match else 0
        records = _decoded(source, real, decode_metrics, problems)
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
                    _LEARNER_NAMES.get(title, title.rpartition("/")[2]): number
                    for title, cell in row.items()
                    if title and "/" in title and math.isfinite(number := _number(cell))
                }
    except (csv.Error, DrError) as error:
        problems.append(f"{name} cannot be read: {error}")
    return found


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


# Reads stand-alone evaluations: traces, else metrics.


TRIAL_COLUMNS = (
    *("trial", "time", "progress", "complete", "crashed", "off_track", "resets"),
    *("clean", "penalty_s", "driven_s", "alone_progress"),
)

MOST_EVALUATIONS = 50
_EVALUATION_METRICS = re.compile(
    r"metrics/(?:EvaluationMetrics-|evaluation/(?:evaluation-)?)(?P<stamp>\d{14})[^/]*\.json"
)


def read_evaluations(
    source: ModelSource,
    named: str | None,
    world_of: "Callable[[pd.DataFrame, str | None], str | None]",
    problems: list[str],
) -> tuple[StoredEvaluation, ...]:
    """All stand-alone evaluations, the oldest first.

    `named` is the track of the newest; `world_of` finds that of steps and what the files say.
    """
    metrics = {
        match["stamp"]: real
        for name, real in source.files.others.items()
        if (match := _EVALUATION_METRICS.fullmatch(name))
    }
    stamps = sorted({*source.files.evaluations, *metrics})
    if len(stamps) > MOST_EVALUATIONS:
        problems.append(
            f"There are {len(stamps)} evaluations; the newest {MOST_EVALUATIONS} are analysed."
        )
        stamps = stamps[-MOST_EVALUATIONS:]
    found = []
    for stamp in stamps:
        of_it = named if stamp == stamps[-1] else None
        evaluation = _from_trace(source, stamp, of_it, world_of, problems)
        if stamp in metrics:
            measured = _from_metrics(source, stamp, metrics[stamp], of_it, problems)
            evaluation = _timed(evaluation, measured) if evaluation else measured
        if evaluation is not None:
            found.append(evaluation)
    return tuple(found)


def _timed(traced: StoredEvaluation, measured: StoredEvaluation | None) -> StoredEvaluation:
    """With the times of the metrics, which races count.

    The clock of the reference stamps a row up to 0.03 s beside the end of its step.
    """
    if measured is None or len(measured.trials) != len(traced.trials):
        return traced
    time_s = measured.trials["time"]
    driven_s = time_s - traced.trials["penalty_s"]
    return replace(traced, trials=traced.trials.assign(time=time_s, driven_s=driven_s))


def _from_trace(
    source: ModelSource,
    stamp: str,
    named: str | None,
    world_of: "Callable[[pd.DataFrame, str | None], str | None]",
    problems: list[str],
) -> StoredEvaluation | None:
    names = source.files.evaluations.get(stamp, ())
    files = [Trace(name, 0, number) for number, name in enumerate(names)]
    if not files:
        return None
    reading = read_traces(files, source.objects.read)
    problems += reading.problems
    if reading.steps is None:
        return None
    steps = reading.steps.sort_values(["iteration", "episode", "steps"], kind="stable")
    steps = steps.reset_index(drop=True)
    return StoredEvaluation(stamp, world_of(steps, named), steps, trials_of(steps))


def trials_of(steps: "pd.DataFrame") -> "pd.DataFrame":
    """A row for each trial of an evaluation.

    In a race without a stop, a lap without a `prepare` row begins where the one before ended, as
    deepracer-utils counts.
    """
    found = aggregated(steps, "episode", is_eval=True)
    first, last = spans(steps["episode"].to_numpy())
    status = steps["episode_status"].astype(str).to_numpy()
    done = steps["done"].to_numpy()
    complete = found["complete"].to_numpy().astype(bool)
    broken = np.isin(status, VIOLATIONS)
    waited_s = np.where(status == "pause", np.diff(steps["tstamp"], prepend=math.nan), 0.0)
    progress = steps["progress"].to_numpy(float)
    resets, penalty_s, alone, clean = [], [], [], []
    for begin, end, lap in zip(first, last, complete, strict=True):
        faults = begin + np.flatnonzero(broken[begin : end + 1])
        # The fault that ended the trial did not put the car back.
        resets.append(len(faults) - int(done[end] and not lap and broken[end]))
        penalty_s.append(float(np.nansum(waited_s[begin : end + 1])))
        alone.append(float(progress[faults[0] if len(faults) else end]))
        clean.append(is_clean_lap(bool(lap), len(faults), penalty_s[-1]))
    time_s = found["time"].to_numpy(float)
    return pd.DataFrame(
        {
            "trial": range(1, len(found) + 1),
            "time": time_s,
            "progress": found["progress"],
            "complete": complete,
            "crashed": found["crashed"].astype(int),
            "off_track": found["off_track"].astype(int),
            "resets": resets,
            "clean": clean,
            "penalty_s": penalty_s,
            "driven_s": time_s - penalty_s,
            "alone_progress": alone,
        }
    )


def _from_metrics(
    source: ModelSource, stamp: str, name: str, world: str | None, problems: list[str]
) -> StoredEvaluation | None:
    try:
        written = json.loads(source.objects.read(name))
        rows = [_trial(number, record) for number, record in enumerate(written["metrics"], 1)]
    except DrError as error:
        problems.append(f"{name} cannot be read: {error}")
        return None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        problems.append(f"{name} is damaged: it is not a file of evaluation metrics.")
        return None
    if not rows:
        return None
    trials = pd.DataFrame(rows, columns=list(TRIAL_COLUMNS))
    return StoredEvaluation(stamp, world, pd.DataFrame(columns=list(STEP_COLUMNS)), trials)


def _trial(number: int, record: Any) -> tuple[Any, ...]:
    progress, resets = float(record["completion_percentage"]), int(record.get("reset_count", 0))
    time_s = float(record["elapsed_time_in_milliseconds"]) / 1000.0
    # Metrics of others tell no penalties, and none tell where the car was put back.
    penalty_s = record.get("penalty_in_milliseconds", math.nan if resets else 0.0) / 1000.0
    return (
        number,
        time_s,
        progress,
        progress >= 100.0,
        int(record.get("crash_count", 0)),
        int(record.get("off_track_count", 0)),
        resets,
        is_clean(record, finished=progress >= 100.0),
        penalty_s,
        time_s - penalty_s,
        math.nan if resets else progress,
    )


# A row for each iteration: from its episodes, else from metrics.


ITERATION_COLUMNS = (
    *("episodes", "steps", "mean_reward", "median_reward", "std_reward", "best_reward"),
    *("mean_progress", "complete_laps", "best_lap_s", "mean_lap_s"),
    *("eval_mean_reward", "eval_mean_progress", "eval_laps", "eval_best_lap_s", "wall_s", "traced"),
    *("phase", "second_clean"),
)

_LONG_PAUSE = 20.0
"""Times the usual time: a pause, such as a night."""


def iteration_table(
    steps: "pd.DataFrame",
    episodes: "pd.DataFrame",
    records: "pd.DataFrame",
    curve: Sequence[IterationRecord],
) -> "pd.DataFrame":
    """The table `Run.iterations`; `curve` is empty for models of others."""
    table = _of_episodes(episodes)
    table["traced"] = True
    missing = _untraced(records[records["phase"] == "training"], table)
    if len(missing):
        table = pd.concat([table, _of_episodes(missing.assign(steps=np.nan))])
    untold = [record for record in curve if record.iteration not in table.index]
    if untold:
        table = pd.concat([table, _of_curve(untold)])
    table = table.sort_index()
    table.index = table.index.astype(int)
    table.index.name = "iteration"
    table["traced"] = table["traced"].eq(True)
    _add_evaluations(table, records[records["phase"] == "evaluation"], curve)
    table["wall_s"] = _wall_s(table, steps, curve)
    table["phase"] = _phases(table.index, curve)
    return table.reindex(columns=list(ITERATION_COLUMNS))


def _untraced(training: "pd.DataFrame", table: "pd.DataFrame") -> "pd.DataFrame":
    """Only of whole iterations: metrics may be ahead of the traces."""
    missing = training[~training["iteration"].isin(table.index)]
    if not len(missing) or not len(table):
        return missing
    last = missing["iteration"].max()
    unfinished = (
        last > table.index.max() and (missing["iteration"] == last).sum() < table["episodes"].max()
    )
    return missing[missing["iteration"] != last] if unfinished else missing


def _of_episodes(episodes: "pd.DataFrame") -> "pd.DataFrame":
    groups = episodes.groupby("iteration")
    reward = groups["reward"]
    laps = episodes[episodes["complete"].astype(bool)].groupby("iteration")["time"]
    return pd.DataFrame(
        {
            "episodes": groups.size(),
            "steps": groups["steps"].sum(min_count=1),
            "mean_reward": reward.mean(),
            "median_reward": reward.median(),
            "std_reward": reward.std(ddof=0),
            "best_reward": reward.max(),
            "mean_progress": groups["progress"].mean(),
            "complete_laps": groups["complete"].sum().astype(int),
            "best_lap_s": laps.min(),
            "mean_lap_s": laps.mean(),
        }
    )


def _of_curve(curve: Sequence[IterationRecord]) -> "pd.DataFrame":
    rows = {
        record.iteration: {
            "episodes": record.episodes,
            "steps": record.steps,
            "mean_reward": record.mean_reward,
            "mean_progress": record.mean_progress,
            "complete_laps": record.full_laps,
            "best_lap_s": np.nan if record.best_lap_s is None else record.best_lap_s,
        }
        for record in curve
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def _add_evaluations(
    table: "pd.DataFrame", records: "pd.DataFrame", curve: Sequence[IterationRecord]
) -> None:
    names = ("eval_mean_reward", "eval_mean_progress", "eval_laps", "eval_best_lap_s")
    for name in (*names, "second_clean"):
        table[name] = np.nan
    if len(records):
        groups = records.groupby("iteration")
        table["eval_mean_reward"] = groups["reward"].mean()
        table["eval_mean_progress"] = groups["progress"].mean()
        table["eval_laps"] = groups["complete"].sum().astype(float)
        laps = records[records["complete"]].groupby("iteration")["time"]
        table["eval_best_lap_s"] = laps.min()
    for record in curve:
        if record.evaluation_progress and record.iteration in table.index:
            row = record.iteration
            # Exact, where the metrics have whole percents.
            table.loc[row, "eval_mean_progress"] = float(np.mean(record.evaluation_progress))
            table.loc[row, "eval_laps"] = float(len(record.evaluation_lap_s))
            if record.evaluation_lap_s:
                table.loc[row, "eval_best_lap_s"] = min(record.evaluation_lap_s)
        if record.second_progress and record.iteration in table.index:
            share = len(record.second_lap_s) / len(record.second_progress)
            table.loc[record.iteration, "second_clean"] = 100.0 * share


def _phases(numbers: "pd.Index[int]", curve: Sequence[IterationRecord]) -> list[str]:
    known = {record.iteration: record.phase for record in curve}
    newest = max(known, default=-1)
    return [known.get(min(int(number), newest), "") for number in numbers]


def _wall_s(
    table: "pd.DataFrame", steps: "pd.DataFrame", curve: Sequence[IterationRecord]
) -> "pd.Series":
    if curve:
        elapsed = pd.Series({record.iteration: record.elapsed_s for record in curve}).sort_index()
        return elapsed.diff().fillna(elapsed.iloc[0]).clip(lower=0.0).reindex(table.index)
    clock = steps["wall_clock"]
    if not len(steps) or clock.isna().all():
        return pd.Series(np.nan, index=table.index)
    groups = clock.groupby(steps["iteration"])
    ends = groups.max()
    lasted = ends.diff()
    lasted.iloc[0] = ends.iloc[0] - groups.min().iloc[0]
    gaps = ends.index.to_series().diff().fillna(1)
    lasted = lasted.where(gaps == 1)  # the trace before is missing
    usual = lasted.median()
    return lasted.where((lasted >= 0) & (lasted <= _LONG_PAUSE * usual), usual).reindex(table.index)

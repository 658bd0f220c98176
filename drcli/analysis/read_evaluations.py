"""Reads stand-alone evaluations: traces, else metrics."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from drcli.analysis.episode_table import aggregated
from drcli.analysis.model_source import ModelSource
from drcli.analysis.read_traces import COLUMNS, TraceFile, read_traces
from drcli.analysis.run import StoredEvaluation
from drcli.analysis.spans import spans
from drcli.base.errors import DrError
from drcli.exchange.episode_metrics import is_clean
from drcli.exchange.laps import is_clean_lap
from drcli.exchange.trace import VIOLATIONS

if TYPE_CHECKING:
    import pandas as pd

TRIAL_COLUMNS = (
    *("trial", "time", "progress", "complete", "crashed", "off_track", "resets"),
    *("clean", "penalty_s", "driven_s", "alone_progress"),
)

MOST_EVALUATIONS = 50
_METRICS = re.compile(
    r"metrics/(?:EvaluationMetrics-|evaluation/(?:evaluation-)?)(?P<stamp>\d{14})[^/]*\.json"
)


class WorldOf(Protocol):
    def __call__(self, steps: "pd.DataFrame", named: str | None = None) -> str | None:
        """The track of steps; `named` is what the files say."""


def read_evaluations(
    source: ModelSource,
    named: str | None,
    world_of: WorldOf,
    problems: list[str],
) -> tuple[StoredEvaluation, ...]:
    """All stand-alone evaluations, the oldest first; `named` is the track of the newest."""
    metrics = {
        match["stamp"]: real
        for name, real in source.files.others.items()
        if (match := _METRICS.fullmatch(name))
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
        evaluation = _from_trace(source, stamp, partial(world_of, named=of_it), problems)
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
    world_of: "Callable[[pd.DataFrame], str | None]",
    problems: list[str],
) -> StoredEvaluation | None:
    names = source.files.evaluations.get(stamp, ())
    files = [TraceFile(name, 0, number) for number, name in enumerate(names)]
    if not files:
        return None
    reading = read_traces(files, source.objects.read)
    problems += reading.problems
    if reading.steps is None:
        return None
    steps = reading.steps.sort_values(["iteration", "episode", "steps"], kind="stable")
    steps = steps.reset_index(drop=True)
    return StoredEvaluation(stamp, world_of(steps), steps, trials_of(steps))


def trials_of(steps: "pd.DataFrame") -> "pd.DataFrame":
    """A row for each trial of an evaluation.

    In a race without a stop, a lap without a `prepare` row begins where the one before ended, as
    deepracer-utils counts.
    """
    import pandas as pd

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
    import pandas as pd

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
    return StoredEvaluation(stamp, world, pd.DataFrame(columns=list(COLUMNS)), trials)


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

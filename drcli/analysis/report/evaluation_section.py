"""The section with evaluations on their own: each trial in a row."""

import math
from typing import Any

from drcli.analysis.report.markup import Content, element, table
from drcli.analysis.report.section import Section
from drcli.analysis.report.words import count, percent, seconds
from drcli.analysis.run import Run, StoredEvaluation

_ROWS = 100
"""Trials of one evaluation that are listed."""


def evaluation_section(run: Run) -> Section | None:
    """Evaluations that were driven after or beside the training."""
    if not run.evaluations:
        return None
    rows = [_summary(evaluation) for evaluation in run.evaluations]
    head = [
        "evaluation",
        "track",
        "trials",
        "full laps",
        "mean progress",
        "best lap (s)",
        "mean lap (s)",
    ]
    content: list[Content] = [table("Evaluations, the oldest first", head, rows, texts=2)]
    for evaluation in run.evaluations:
        trials = [_trial(trial) for _, trial in evaluation.trials[:_ROWS].iterrows()]
        columns = ["trial", "time (s)", "progress", "full lap", "crashes", "off track", "resets"]
        name = f"Trials of {evaluation.stamp}"
        content.append(element("details", element("summary", name), table(name, columns, trials)))
    look = (
        "Look at whether every trial completes the lap without a reset, and whether the times are "
        "close together: a race counts what happens every time."
    )
    return Section("evaluations", "Evaluations", "Evaluations", look, tuple(content))


def _summary(evaluation: StoredEvaluation) -> list[Content]:
    trials = evaluation.trials
    full = trials[trials["complete"].astype(bool)]
    return [
        evaluation.stamp,
        evaluation.world or "",
        count(len(trials)),
        count(len(full)),
        percent(trials["progress"].mean() if len(trials) else math.nan),
        seconds(full["time"].min() if len(full) else math.nan),
        seconds(full["time"].mean() if len(full) else math.nan),
    ]


def _trial(row: Any) -> list[Content]:
    return [
        count(row["trial"]),
        seconds(row["time"]),
        percent(row["progress"]),
        "yes" if row["complete"] else "no",
        count(row["crashed"]),
        count(row["off_track"]),
        count(row["resets"]),
    ]

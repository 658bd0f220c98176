"""The section with the trials of evaluations on their own."""

import math
from typing import Any

from drcli.analysis.report.markup import Content, element, table
from drcli.analysis.report.section import Section
from drcli.analysis.report.words import count, percent, seconds
from drcli.analysis.run import Run, StoredEvaluation

_ROWS = 100


def evaluation_section(run: Run) -> Section | None:
    if not run.evaluations:
        return None
    rows = [_summary(evaluation) for evaluation in run.evaluations]
    head = [
        "evaluation",
        "track",
        "laps",
        "clean",
        "finished",
        "resets",
        "best clean (s)",
        "median clean (s)",
        "best finished (s)",
    ]
    content: list[Content] = [table("Evaluations, the oldest first", head, rows, texts=2)]
    for evaluation in run.evaluations:
        trials = [_trial(trial) for _, trial in evaluation.trials[:_ROWS].iterrows()]
        columns = [
            *("lap", "clean", "finished", "time (s)", "driven (s)", "penalty (s)"),
            *("progress", "before a reset", "crashes", "off track", "resets"),
        ]
        name = f"Trials of {evaluation.stamp}"
        content.append(element("details", element("summary", name), table(name, columns, trials)))
    look = (
        "A clean lap has neither a reset nor a penalty. A finished lap may have both: its time "
        "contains them. Look at whether every lap is clean, and whether the times are close "
        "together: a race counts what happens every time."
    )
    return Section("evaluations", "Evaluations", "Evaluations", look, tuple(content))


def _summary(evaluation: StoredEvaluation) -> list[Content]:
    trials, laps = evaluation.trials, evaluation.laps
    finished = trials[trials["complete"].astype(bool)]
    return [
        evaluation.stamp,
        evaluation.world or "",
        count(laps.driven),
        count(laps.clean),
        count(len(finished)),
        count(evaluation.resets),
        seconds(math.nan if laps.fastest_s is None else laps.fastest_s),
        seconds(math.nan if laps.median_s is None else laps.median_s),
        seconds(finished["time"].min() if len(finished) else math.nan),
    ]


def _trial(row: Any) -> list[Content]:
    return [
        count(row["trial"]),
        "yes" if row["clean"] else "no",
        "yes" if row["complete"] else "no",
        seconds(row["time"]),
        seconds(row["driven_s"]),
        seconds(row["penalty_s"]),
        percent(row["progress"]),
        percent(row["alone_progress"]),
        count(row["crashed"]),
        count(row["off_track"]),
        count(row["resets"]),
    ]

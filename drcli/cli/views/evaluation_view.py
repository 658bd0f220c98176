"""Shows the trials of an evaluation, and who won a race."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, counted

if TYPE_CHECKING:
    from drcli.runs.evaluation_report import EvaluationReport


def evaluation(report: "EvaluationReport") -> RenderableType:
    """The trials of an evaluation, and the sentence that sums them up."""
    other = report.opponent
    if other is None:
        return Group(_trials(report), _bold(_laps(report)), *_videos(report))
    cars = (_bold(_name(report)), _trials(report), _bold(_name(other)), _trials(other))
    result = (_laps(report), _laps(other), _winner(report, other))
    return Group(*cars, *map(_bold, result), *_videos(report), *_videos(other))


def _videos(report: "EvaluationReport") -> list[Text]:
    """Where the film with everything over it is."""
    return [Text(f"Video: {key}") for key in report.videos[-1:]]


def _name(report: "EvaluationReport") -> str:
    """What a racer is called: its model, or the file that drives."""
    return report.prefix if report.file is None else report.checkpoint


def _bold(text: str) -> Text:
    return Text(text, style="bold")


def _trials(report: "EvaluationReport") -> Rows:
    return Rows(
        ("trial", "progress", "lap time", "status", "off track", "crashes", "resets"),
        [
            (
                str(trial.trial),
                f"{trial.progress:.0f} %",
                f"{trial.lap_s:.2f} s",
                trial.status,
                str(trial.off_track),
                str(trial.crashes),
                str(trial.resets),
            )
            for trial in report.trials
        ],
        left=("status",),
    )


def _laps(report: "EvaluationReport") -> str:
    best = f", best {report.best_lap_s:.2f} s" if report.best_lap_s is not None else ""
    if report.best_average_s is not None and report.average_laps > 1:
        best += f", best average of {report.average_laps} laps {report.best_average_s:.2f} s"
    driver = report.checkpoint
    if report.file is None:
        driver = f"checkpoint {driver} of {report.prefix}"
    engine = "" if report.runtime == "torch" else f" with --runtime {report.runtime}"
    return (
        f"{report.completed} of {counted(len(report.trials), 'lap')}{best}, "
        f"{driver}{engine} on {report.world}."
    )


def _winner(own: "EvaluationReport", other: "EvaluationReport") -> str:
    """The model with more laps wins, then the one with less time for all laps."""
    if own.completed != other.completed:
        first = own if own.completed > other.completed else other
        return f"{_name(first)} wins with more laps."
    if own.total_s is None or other.total_s is None or own.total_s == other.total_s:
        return "Nobody wins."
    first, second = (own, other) if own.total_s < other.total_s else (other, own)
    ahead_s = abs(own.total_s - other.total_s)
    return f"{_name(first)} wins, {ahead_s:.2f} s ahead of {_name(second)}."

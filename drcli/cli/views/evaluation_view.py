"""Shows the trials of an evaluation."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows

if TYPE_CHECKING:
    from drcli.runs.evaluation_report import EvaluationReport, TrialReport


def evaluation(report: "EvaluationReport") -> RenderableType:
    other = report.opponent
    if other is None:
        return Group(_trials(report), _bold(_laps(report)), *_limit(report), *_videos(report))
    cars = (_bold(_name(report)), _trials(report), _bold(_name(other)), _trials(other))
    result = (_laps(report), _laps(other), _winner(report, other))
    return Group(*cars, *map(_bold, result), *_videos(report), *_videos(other))


def _limit(report: "EvaluationReport") -> list[Text]:
    lost = f"Most time is lost at {'; '.join(report.lost)}." if report.lost else ""
    return [Text(line) for line in (report.limit and f"{report.limit}.", lost) if line]


def _videos(report: "EvaluationReport") -> list[Text]:
    return [Text(f"Video: {key}") for key in report.videos[-1:]]


def _name(report: "EvaluationReport") -> str:
    return report.prefix if report.file is None else report.checkpoint


def _bold(text: str) -> Text:
    return Text(text, style="bold")


def _trials(report: "EvaluationReport") -> Rows:
    penalties = any(trial.penalty_s for trial in report.trials)
    crashes = any(trial.crashes for trial in report.trials)
    return Rows(
        (
            *("trial", "progress", "lap time"),
            *(("driven", "penalty") if penalties else ()),
            *("ended", "off track"),
            *(("crashes",) if crashes else ()),
            "resets",
        ),
        [
            (
                str(trial.trial),
                f"{trial.progress:.0f} %",
                f"{trial.lap_s:.2f} s",
                *(_parts(trial) if penalties else ()),
                _ended(trial),
                str(trial.off_track),
                *((str(trial.crashes),) if crashes else ()),
                str(trial.resets),
            )
            for trial in report.trials
        ],
        left=("ended",),
    )


def _parts(trial: "TrialReport") -> tuple[str, str]:
    if trial.penalty_s is None:
        return "", ""
    return f"{trial.lap_s - trial.penalty_s:.2f} s", f"{trial.penalty_s:.2f} s"


def _ended(trial: "TrialReport") -> str:
    if not trial.finished:
        return trial.status
    return "clean lap" if trial.clean else "finished"


def _laps(report: "EvaluationReport") -> str:
    from drcli.exchange.laps import counted_resets
    from drcli.runs.evaluation_report import best_average, summary

    words = summary(report.trials)
    run = best_average(report.trials, report.average_laps)
    if run and report.average_laps > 1:
        words += f", best average of {report.average_laps} laps {report.best_average_s:.2f} s"
        resets = sum(trial.resets for trial in run)
        words += f" with {counted_resets(resets)}" if resets else ""
    driver = report.checkpoint
    if report.file is None:
        driver = f"checkpoint {driver} of {report.prefix}"
    engine = "" if report.runtime == "torch" else f" with --runtime {report.runtime}"
    return f"{words}; {driver}{engine} on {report.world}."


def _winner(own: "EvaluationReport", other: "EvaluationReport") -> str:
    """More finished laps win, then less time."""
    if own.completed != other.completed:
        first = own if own.completed > other.completed else other
        return f"{_name(first)} wins with more finished laps."
    if own.total_s is None or other.total_s is None or own.total_s == other.total_s:
        return "Nobody wins."
    first, second = (own, other) if own.total_s < other.total_s else (other, own)
    ahead_s = abs(own.total_s - other.total_s)
    return f"{_name(first)} wins, {ahead_s:.2f} s ahead of {_name(second)}."

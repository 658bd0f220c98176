"""Tables of many evaluations."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows
from drcli.exchange.laps import lap_time

if TYPE_CHECKING:
    from drcli.exchange.robust_result import RobustCell, RobustResult
    from drcli.runs.evaluation_loop import LoopReport
    from drcli.runs.many_evaluations import TableReport


def models_table(report: "TableReport") -> RenderableType:
    driven = [row for row in report.rows if not row.reason]
    columns = {
        "track": [row.world for row in driven],
        "model": [row.prefix for row in driven],
        "checkpoint": [row.checkpoint for row in driven],
        "clean laps": [f"{row.clean}/{row.trials}" for row in driven],
        "resets": [str(row.resets) for row in driven],
        "progress": [f"{row.progress:.0f} %" for row in driven],
        "median": [_seconds(row.median_s) for row in driven],
        "best lap": [_seconds(row.best_lap_s) for row in driven],
        "best average": [_seconds(row.best_average_s) for row in driven],
        "robust score": [_score(row.robust_score) for row in driven],
    }
    # Which of the last ones there are depends on what was driven.
    columns = {name: cells for name, cells in columns.items() if any(cells) or not driven}
    parts: list[RenderableType] = [
        Rows(
            list(columns),
            list(zip(*columns.values(), strict=True)),
            left=("track", "model", "checkpoint"),
        )
    ]
    failed = [row for row in report.rows if row.reason]
    if failed:
        parts.append(
            Rows(
                ("track", "model", "not evaluated"),
                [(row.world, row.prefix, row.reason) for row in failed],
                left=("track", "model", "not evaluated"),
            )
        )
    for best in report.best:
        parts.append(Text(f"Best on {best.world}: {best.prefix}. Train on from it there with:"))
        parts.append(Text(f"  {best.command}", style="bold"))
    return Group(*parts)


def robust_grid(result: "RobustResult") -> RenderableType:
    rows = Rows(
        ("disturbed", "level", "clean laps", "progress", "lap time", "ended by", "score of axis"),
        [
            (
                cell.axis,
                cell.level,
                f"{cell.completed}/{cell.trials}",
                f"{cell.progress:.0f} %",
                _seconds(cell.lap_s),
                cell.ended_by,
                f"{result.axis_scores[cell.axis]:.1f}" if first else "",
            )
            for cell, first in _with_first(result)
        ],
        left=("disturbed", "level", "ended by"),
    )
    broken = ", ".join(result.broken_by)
    said = f"Broken by: {broken}." if broken else "No level of the grid broke it."
    if result.cells[0].completed == 0:
        said = "It completes no clean lap even without disturbance."
    score = (
        f"Robust score {result.robust_score:.1f} of 100: checkpoint {result.checkpoint} of "
        f"{result.prefix} on {result.world}, seed {result.seed}."
    )
    return Group(rows, Text(said), Text(score, style="bold"))


def _with_first(result: "RobustResult") -> list[tuple["RobustCell", bool]]:
    axes = [cell.axis for cell in result.cells]
    return [(cell, axes.index(cell.axis) == place) for place, cell in enumerate(result.cells)]


def best_laps(report: "LoopReport") -> RenderableType:
    rounds = f"{report.rounds} round{'s' * (report.rounds != 1)}"
    failed = f", {report.failures} failed" if report.failures else ""
    said = Text(f"{rounds}{failed} of {report.prefix} on {report.world}.", style="bold")
    if not report.best:
        return Group(Text("No lap was completed."), said)
    rows = Rows(
        ("track", "best lap", "resets", "best average", "clean laps", "checkpoint", "driven"),
        [
            (
                lap.world,
                lap_time(lap.best_lap_s, lap.penalty_s, 0),
                "?" if lap.resets is None else str(lap.resets),
                _seconds(lap.best_average_s),
                f"{'?' if lap.clean is None else lap.clean}/{lap.trials}",
                lap.checkpoint,
                lap.driven_at,
            )
            for lap in report.best
        ],
        left=("track", "best lap", "checkpoint", "driven"),
    )
    return Group(rows, said)


def _score(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.2f} s"

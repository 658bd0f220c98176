"""Tables of many evaluations: of models and tracks, of a grid of disturbances, of best laps."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows

if TYPE_CHECKING:
    from drcli.exchange.robust_result import RobustCell, RobustResult
    from drcli.runs.evaluation_loop import LoopReport
    from drcli.runs.many_evaluations import TableReport, TableRow


def models_table(report: "TableReport") -> RenderableType:
    """The models on each track, the best first, and the commands that train on from the best."""
    robust = any(row.robust_score is not None for row in report.rows)
    heads = ("track", "model", "checkpoint", "laps", "progress", "best lap", "best average")
    parts: list[RenderableType] = [
        Rows(
            (*heads, "robust score") if robust else heads,
            [_row(row, robust=robust) for row in report.rows if not row.reason],
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


def _row(row: "TableRow", *, robust: bool) -> tuple[str, ...]:
    cells = (
        row.world,
        row.prefix,
        row.checkpoint,
        f"{row.completed}/{row.trials}",
        f"{row.progress:.0f} %",
        _seconds(row.best_lap_s),
        _seconds(row.best_average_s),
    )
    if not robust:
        return cells
    return (*cells, "" if row.robust_score is None else f"{row.robust_score:.1f}")


def robust_grid(result: "RobustResult") -> RenderableType:
    """Every level of every disturbance, what broke the model, and its score."""
    rows = Rows(
        ("disturbed", "level", "laps", "progress", "lap time", "ended by", "score of axis"),
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
        said = "It completes no lap even without disturbance."
    score = (
        f"Robust score {result.robust_score:.1f} of 100: checkpoint {result.checkpoint} of "
        f"{result.prefix} on {result.world}, seed {result.seed}."
    )
    return Group(rows, Text(said), Text(score, style="bold"))


def _with_first(result: "RobustResult") -> list[tuple["RobustCell", bool]]:
    """The cells, each with whether it is the first one of its axis."""
    axes = [cell.axis for cell in result.cells]
    return [(cell, axes.index(cell.axis) == place) for place, cell in enumerate(result.cells)]


def best_laps(report: "LoopReport") -> RenderableType:
    """The best rounds of a loop, and how many there were."""
    rounds = f"{report.rounds} round{'s' * (report.rounds != 1)}"
    failed = f", {report.failures} failed" if report.failures else ""
    said = Text(f"{rounds}{failed} of {report.prefix} on {report.world}.", style="bold")
    if not report.best:
        return Group(Text("No lap was completed."), said)
    rows = Rows(
        ("track", "best lap", "best average", "laps", "checkpoint", "driven"),
        [
            (
                lap.world,
                _seconds(lap.best_lap_s),
                _seconds(lap.best_average_s),
                f"{lap.completed}/{lap.trials}",
                lap.checkpoint,
                lap.driven_at,
            )
            for lap in report.best
        ],
        left=("track", "checkpoint", "driven"),
    )
    return Group(rows, said)


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.2f} s"

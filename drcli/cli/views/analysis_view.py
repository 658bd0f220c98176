"""Shows analyses and comparisons."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import fmean
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.analysis.comparison_rows import ComparisonRow, Kind, comparison_rows, interval_rows
from drcli.cli.views import sparkline
from drcli.cli.views.iterations import BESIDE_CURVE, CURVE_COLUMNS, LEAST_CURVE_COLUMNS
from drcli.cli.views.layout import Rows, counted, fitted, indented

if TYPE_CHECKING:
    from drcli.analysis.analysis import AnalysisReport
    from drcli.analysis.compare_runs import ComparedPair, Comparison

PARTS = 5
ADVICE = 2
_GOOD = {"improving", "converged"}
_BAD = {"collapsed", "declining", "not_learning"}

_DIFF_STYLES = {"+": "green", "-": "red", "@": "cyan"}

Row = dict[str, Any]


@fitted
def analysis(columns: int, report: "AnalysisReport") -> RenderableType:
    parts: list[RenderableType] = [*_head(report), _verdict(report.verdict)]
    if report.iterations:
        parts += _curves(report.iterations, columns)
        parts.append(_parts_table(report.iterations))
    parts += _evaluations(report.evaluations)
    parts += _advice(report.advice)
    written = [*([report.html] if report.html else []), *report.png]
    parts += [Text(f"Wrote {path}") for path in written]
    return Group(*parts)


@fitted
def comparison(columns: int, report: "Comparison") -> RenderableType:
    names = ["", *(run.model for run in report.runs)]
    cells = [
        [_row_name(row), *(_cell(row, value) for value in row.values)]
        for row in comparison_rows(report)
    ]
    late = ", ".join(str(run.late_iterations) for run in report.runs)
    parts: list[RenderableType] = [
        Rows(names, cells, left=("",)),
        Text(f"late: the newest {late} iterations.", style="dim"),
    ]
    for pair in report.pairs:
        parts += _pair(report.runs[0].model, pair)
    if report.html:
        parts.append(Text(f"Wrote {report.html}"))
    return Group(*parts)


def _head(report: "AnalysisReport") -> list[RenderableType]:
    track = report.world or "an unknown track"
    if report.track_length_m:
        track += f", {report.track_length_m:.1f} m"
    driven = (
        f"{counted(len(report.iterations), 'iteration')}, {counted(report.episodes, 'episode')}, "
        f"{counted(report.steps, 'step')}; {counted(report.complete_laps, 'clean lap')}"
    )
    if report.best_lap_s is not None:
        driven += f", best {_seconds(report.best_lap_s)}"
    head = [Text(f"{report.model} ({track})", style="bold"), Text(driven)]
    return [*head, Text(f"The best lap, {report.limit}.")] if report.limit else [*head]


def _verdict(verdict: Row) -> Text:
    kind = verdict["kind"]
    style = "green" if kind in _GOOD else "red" if kind in _BAD else "yellow"
    text = Text("Verdict: ", style="bold")
    return text.append(verdict["sentence"], style=f"not bold {style}")


def _curves(rows: Sequence[Row], columns: int) -> list[RenderableType]:
    width = max(LEAST_CURVE_COLUMNS, min(CURVE_COLUMNS, columns - BESIDE_CURVE))
    lines = (
        ("reward", "mean_reward", None, "cyan", "{:.1f}"),
        ("progress", "mean_progress", 100.0, "green", "{:.0f} %"),
    )
    shown: list[RenderableType] = []
    for title, key, top, style, form in lines:
        values = [row[key] for row in rows if row[key] is not None]
        if values:
            drawn = sparkline.curve(values, width, top=top)
            ends = f"{form.format(values[0])} to {form.format(values[-1])}"
            shown.append(
                Text.assemble((f"{title:9}", "dim"), (f"{drawn:{width}}", style), "  ", ends)
            )
    return shown


def _parts_table(rows: Sequence[Row]) -> RenderableType:
    count = min(PARTS, len(rows))
    edges = [round(i * len(rows) / count) for i in range(count + 1)]
    cells = []
    for start, end in pairwise(edges):
        part = rows[start:end]
        first, last = part[0]["iteration"], part[-1]["iteration"]
        laps = [row["best_lap_s"] for row in part if row["best_lap_s"] is not None]
        cells.append(
            (
                str(first) if first == last else f"{first}-{last}",
                _number(_mean(part, "mean_reward")),
                _percent(_mean(part, "mean_progress")),
                f"{sum(row['complete_laps'] for row in part):,.0f}",
                _seconds(min(laps, default=None)),
                _percent(_mean(part, "eval_mean_progress")),
            )
        )
    names = ("iterations", "reward", "progress", "clean laps", "best lap", "evaluation")
    kept = len(names) - all(row[-1] == "-" for row in cells)
    return Rows(names[:kept], [row[:kept] for row in cells])


def _evaluations(evaluations: Sequence[Row]) -> list[RenderableType]:
    if not evaluations:
        return []
    count = counted(len(evaluations), "evaluation")
    return [Text(f"{count}; the newest: {evaluations[-1]['summary']}")]


def _advice(advice: Sequence[Row]) -> list[RenderableType]:
    if not advice:
        return [Text("No advice: nothing in the data shows a fault.", style="dim")]
    shown: list[RenderableType] = []
    for number, item in enumerate(advice[:ADVICE], 1):
        shown.append(Text.assemble((f"{number}. {item['title']}. ", "bold"), item["evidence"]))
        shown.append(indented(Text(item["command"], style="cyan")))
    more = [item["title"] for item in advice[ADVICE:]]
    if more:
        shown.append(Text(f"Also: {'; '.join(more)}.", style="dim"))
    return shown


def _pair(first: str, pair: "ComparedPair") -> list[RenderableType]:
    parts: list[RenderableType] = [Text(pair.sentence, style="bold")]
    for row in interval_rows(pair):
        text = (
            f"{row.name} {row.difference:+.2f} {row.unit}".rstrip()
            + f" (95 % between {row.low:+.2f} and {row.high:+.2f})"
        )
        parts.append(indented(Text(text)))
    for name, text in pair.files.items():
        parts.append(Text(f"{name}: {first} (-), {pair.model} (+)", style="dim"))
        lines = text.splitlines()[2:]
        parts += [indented(Text(line, style=_DIFF_STYLES.get(line[:1], ""))) for line in lines]
    if not pair.files:
        parts.append(Text("Their files are equal, or not known.", style="dim"))
    return parts


def _row_name(row: ComparisonRow) -> str:
    return row.name if row.limit is None else f"{row.name} {_WRITTEN[row.limit[0]](row.limit[1])}"


def _cell(row: ComparisonRow, value: float | None) -> str:
    return row.unknown if value is None and row.unknown else _WRITTEN[row.kind](value)


def _mean(rows: Sequence[Row], key: str) -> float | None:
    values = [row[key] for row in rows if row[key] is not None]
    return fmean(values) if values else None


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:,.1f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} %"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f} s"


def _usd(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} USD"


def _hours(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value / 60:.1f} min" if value < 5400 else f"{value / 3600:.2f} h"


def _count(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"


def _steps(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f} steps"


_WRITTEN: dict[Kind, Callable[[float | None], str]] = {
    "count": _count,
    "percent": _percent,
    "lap": _seconds,
    "time": _hours,
    "usd": _usd,
    "number": _number,
    "steps": _steps,
}

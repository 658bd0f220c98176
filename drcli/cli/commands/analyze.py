"""`dr analyze`."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.installation import lazy_imports
from drcli.cli import completion, console
from drcli.cli.evaluation_options import with_options
from drcli.cli.options import Replace
from drcli.cli.views import iterations
from drcli.cli.views.iterations import BESIDE_CURVE, CURVE_COLUMNS, LEAST_CURVE_COLUMNS
from drcli.cli.views.layout import Rows, counted, fitted, indented
from drcli.cli.working_folder import settings_for_files
from drcli.model import keys
from drcli.model.model_store import ModelStore

if TYPE_CHECKING:
    from drcli.analysis.analysis import AnalysisReport
    from drcli.analysis.report.graphs import Picture
    from drcli.config.settings import Settings

with lazy_imports():
    from drcli.analysis import analysis as analyses
    from drcli.analysis import compare_runs, explained_model, model_source, outputs, read_run
    from drcli.transfer import transfer_buckets

# Shows analyses and comparisons.


PARTS = 5
ADVICE = 2
_GOOD = {"improving", "converged"}
_BAD = {"collapsed", "declining", "not_learning"}

_DIFF_STYLES = {"+": "green", "-": "red", "@": "cyan"}

Row = dict[str, Any]


@fitted
def show_analysis(columns: int, report: "AnalysisReport") -> RenderableType:
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
def comparison(columns: int, report: "compare_runs.Comparison") -> RenderableType:
    names = ["", *(run.model for run in report.runs)]
    cells = [
        [_row_name(row), *(_cell(row, value) for value in row.values)]
        for row in compare_runs.comparison_rows(report)
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
            drawn = iterations.curve(values, width, top=top)
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


def _pair(first: str, pair: "compare_runs.ComparedPair") -> list[RenderableType]:
    parts: list[RenderableType] = [Text(pair.sentence, style="bold")]
    for row in compare_runs.interval_rows(pair):
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


def _row_name(row: "compare_runs.ComparisonRow") -> str:
    return row.name if row.limit is None else f"{row.name} {_WRITTEN[row.limit[0]](row.limit[1])}"


def _cell(row: "compare_runs.ComparisonRow", value: float | None) -> str:
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


_WRITTEN: "dict[compare_runs.Kind, Callable[[float | None], str]]" = {
    "count": _count,
    "percent": _percent,
    "lap": _seconds,
    "time": _hours,
    "usd": _usd,
    "number": _number,
    "steps": _steps,
}


COMPARE = "compare"


def analyze(
    what: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="WHAT",
            help="A model, s3://bucket/prefix, a folder or an archive; the model of run.env if "
            "left out. After the word compare: two or more of them.",
            autocompletion=completion.model_prefixes,
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html", metavar="FILE", help="Write the report, or the comparison, as one HTML file."
        ),
    ] = None,
    png: Annotated[
        Path | None, typer.Option("--png", metavar="FOLDER", help="Write its pictures there.")
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Also show in the report what moves the action: drives an episode of the best "
            "checkpoint.",
        ),
    ] = False,
    local: Annotated[
        bool, typer.Option("-L", "--local", help="s3:// is a bucket of the local server.")
    ] = False,
    force: Replace = False,
) -> None:
    """Show what a training came to: a verdict, curves, laps, and what to change, with evidence.

    Reads models of drcli, DeepRacer-for-Cloud, the DeepRacer console and DeepRacer on AWS, also
    while they are trained, and changes nothing. Archives can be .tar.gz, .tgz, .tar and .zip.
    `compare A B` shows two or more side by side, and whether they differ by more than chance.

    Example: dr-analyze team/model-1 --html report.html
    """
    words = what or []
    if explain and html is None:
        raise typer.BadParameter("--explain adds pictures to the report; name that with --html.")
    if words[:1] == [COMPARE]:
        _compare(words[1:], html, png, local=local, force=force)
        return
    if len(words) > 1:
        raise typer.BadParameter(
            f"There are {len(words)} models; one can be analysed. To compare them: "
            f"dr-analyze {COMPARE} {' '.join(words)}."
        )

    loaded = settings_for_files(words)
    name = words[0] if words else None
    outputs.check_targets(html, png, force=force)
    if explain:
        _refuse_outside_the_bucket(loaded, name)
    with console.waiting(f"Reading {name or loaded.model_prefix} ..."):
        analysis = analyses.analyse(read_run.read_run(loaded, name, local=local))
    explained = _explained(loaded, name, analysis.run.world) if explain else ()
    with console.waiting("Writing ...") if html or png else console.waiting("", only_live=True):
        report = outputs.write_outputs(analysis, html, png, explained, force=force)
    console.warn(*report.problems)
    console.emit(report, show_analysis(report))
    if not console.as_json and html is None:
        given = f" {name}" if name else ""
        console.suggest([(f"dr-analyze{given} --html report.html", "graphs, map and each episode")])


def _explained(loaded: "Settings", name: str | None, world: str | None) -> "tuple[Picture, ...]":
    prefix = loaded.model_prefix if name is None else name.strip("/")
    with console.waiting("Driving an episode and explaining it ..."):
        bucket = transfer_buckets.bucket_to_look_at(loaded.transfer, upload=False)
        return explained_model.explained_pictures(
            with_options(loaded, DR_WORLD_NAME=world), ModelStore(bucket, prefix)
        )


def _refuse_outside_the_bucket(loaded: "Settings", name: str | None) -> None:
    if name is None:
        return
    prefix = name.strip("/")
    if (
        not keys.is_valid_prefix(prefix)
        or prefix.casefold().startswith("s3:")
        or not model_source.open_model(loaded, name).origin.startswith("s3://")
    ):
        raise typer.BadParameter(
            f"--explain drives a model of the bucket, and {name} is not one. To explain a "
            "policy's file: dr-saliency --model FILE."
        )


def _compare(
    words: list[str],
    html: Path | None,
    png: Path | None,
    *,
    local: bool,
    force: bool,
) -> None:
    if len(words) < 2:
        raise typer.BadParameter(f"Name two or more models after {COMPARE}.")
    if png is not None:
        raise typer.BadParameter(f"--png is for one model; {COMPARE} writes --html and --json.")
    loaded = settings_for_files(words)
    outputs.check_targets(html, None, force=force)
    with console.waiting(f"Reading {', '.join(words)} ..."):
        report = outputs.write_comparison_of(read_run.read_runs(loaded, words, local=local), html)
    console.warn(*report.problems)
    console.emit(report, comparison(report))

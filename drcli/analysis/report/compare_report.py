"""Writes a comparison of trainings as one HTML file."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from drcli.analysis.compare_runs import (
    ComparedPair,
    ComparedRun,
    Comparison,
)
from drcli.analysis.report.document import html_document
from drcli.analysis.report.graphs import Graph, Section, Series
from drcli.analysis.report.markup import (
    Content,
    Html,
    coloured_difference,
    element,
    percent,
    seconds,
    table,
    tiles,
)
from drcli.analysis.report.summary_sections import problems_box
from drcli.base.files import rewrite
from drsim.arrays import Floats

_COLORS = 8
_POINTS = 60
_HOURS_FROM_S = 5400.0


def write_comparison(report: Comparison, path: Path) -> int:
    """Write the page, and return its size in bytes.

    Raises:
        SettingsError: It cannot be written.
    """
    data = comparison_page(report).encode("utf-8")
    rewrite(path, data)
    return len(data)


def comparison_page(report: Comparison) -> str:
    names = [run.model for run in report.runs]
    title = f"{', '.join(names[:-1])} and {names[-1]} compared"
    origins = [
        element("p", f"{run.origin}, {run.world or 'track not known'}", class_="origin")
        for run in report.runs
    ]
    facts = [(run.model, _fact(run.best_lap_s, run.late_progress)) for run in report.runs[:_COLORS]]
    overview = element(
        "div", tiles(facts), problems_box(report.problems, "What limits this comparison:")
    )
    sections = [
        _difference_section(report),
        _numbers_section(report),
        *filter(None, (_progress_section(report.runs), _lap_section(report))),
        *filter(None, (_reward_section(report),)),
        _files_section(report),
    ]
    return html_document(title, origins, overview, sections)


def _fact(best_lap_s: float | None, late_progress: float | None) -> str:
    if best_lap_s is not None:
        return f"best lap {seconds(best_lap_s)} s"
    return "no data" if late_progress is None else f"{percent(late_progress)} of a lap"


def _difference_section(report: Comparison) -> Section:
    first = report.runs[0].model
    content: list[Content] = []
    for pair in report.pairs:
        content.append(element("p", pair.sentence, class_="verdict"))
        rows: list[list[Content]] = [
            [
                name,
                "yes" if found["beyond_chance"] else "no",
                f"{found['difference']:+.2f}",
                f"{found['low']:+.2f} to {found['high']:+.2f}",
            ]
            for name, found in pair.intervals().items()
        ]
        if rows:
            head = ["", "more than chance", "difference", "95 % of the resamples"]
            content.append(table(f"{pair.model} less {first}", head, rows))
    late = ", ".join(str(run.late_iterations) for run in report.runs)
    content.append(
        element(
            "p",
            f"These are the newest {late} iterations, drawn again 2000 times with replacement: "
            "first iterations, then their episodes. This is the noise within each training; how "
            "much another seed changes a result, only a second training with it can show.",
            class_="quiet",
        )
    )
    look = (
        "Look at the intervals: a difference counts only if its interval does not contain 0, "
        "however large it is."
    )
    return Section("differences", "What differs by more than chance", "Chance", look, (*content,))


def _numbers_section(report: Comparison) -> Section:
    rows: list[list[Content]] = [[str(cell) for cell in row] for row in report.numbers()]
    head = ["", *(run.model for run in report.runs)]
    look = (
        'Look at the rows with "at", which are fair to a shorter training: they show how far each '
        "had come when it had used as much as the shortest one used in all."
    )
    return Section(
        "numbers",
        "Side by side",
        "Numbers",
        look,
        (table("Late: the newest iterations", head, rows),),
    )


def _progress_section(runs: Sequence[ComparedRun]) -> Section | None:
    hours = max((run.wall_s or 0.0 for run in runs), default=0.0) >= _HOURS_FROM_S
    axes = (
        ("steps", "steps", 1.0, 0),
        ("wall_s", "hours" if hours else "minutes", 3600.0 if hours else 60.0, 2),
        ("usd", "USD", 1.0, 3),
    )
    content: list[Content] = []
    graphs = []
    for name, label, unit, decimals in axes:
        known = [run for run in runs if _has(run, name) and _has(run, "progress")]
        what = {"steps": "steps", "wall_s": "wall time", "usd": "money"}[name]
        if known:
            title = f"Mean progress over {what}" + (f" ({label})" if what != label else "")
            graph = _graph(title, runs, "progress", name, label, unit, decimals, "progress (%)")
            graphs.append(graph)
            content.append(graph.as_html())
        missing = [run.model for run in runs if run not in known]
        if missing:
            content.append(_missing(what, missing))
    evaluated = [run for run in runs if _has(run, "eval_progress")]
    if evaluated:
        title = "Mean progress of the evaluations over steps"
        graph = _graph(title, runs, "eval_progress", "steps", "steps", 1.0, 0, "progress (%)")
        graphs.append(graph)
        content.append(graph.as_html())
    if not graphs:
        return None
    look = (
        "Look at which line is higher at the same place: over steps it shows which training "
        "learns more from the same driving, over wall time and money which one is cheaper."
    )
    content.append(_smoothing(runs))
    return Section("progress", "Progress", "Progress", look, tuple(content), tuple(graphs))


def _missing(what: str, models: Sequence[str]) -> Html:
    names = " and ".join(filter(None, (", ".join(models[:-1]), models[-1])))
    text = {
        "steps": f"The progress of {names} is not known.",
        "wall time": f"The wall time of {names} is not known.",
        "money": f"The cost of {names} is not known: it is recorded where DR_SPOT_PRICE is set.",
    }[what]
    return element("p", text, class_="quiet")


def _smoothing(runs: Sequence[ComparedRun]) -> Content:
    averaged = sorted({_window(run) for run in runs} - {1})
    if not averaged:
        return None
    windows = " or ".join(map(str, averaged))
    text = f"A point of a long training is the mean of {windows} neighbouring iterations."
    return element("p", text, class_="quiet")


def _lap_section(report: Comparison) -> Section | None:
    runs = report.runs
    if not any(_has(run, "lap_s") for run in runs):
        return None
    graph = _graph("Mean lap time over steps", runs, "lap_s", "steps", "steps", 1.0, 0, "seconds")
    look = "Look for the line that is lowest late in the training: only clean laps count here."
    return Section("laps", "Lap times", "Laps", look, (graph.as_html(),), (graph,))


def _reward_section(report: Comparison) -> Section | None:
    if not all(pair.same_reward for pair in report.pairs):
        return None
    runs = report.runs
    graph = _graph("Mean reward over steps", runs, "reward", "steps", "steps", 1.0, 0, "reward")
    look = (
        "Look at whether the order of the lines is that of the progress: all trainings have the "
        "same reward function, so their rewards can be compared."
    )
    return Section("reward", "Reward", "Reward", look, (graph.as_html(),), (graph,))


def _files_section(report: Comparison) -> Section:
    content: list[Content] = []
    for pair in report.pairs:
        content += _file_parts(report.runs[0].model, pair)
    look = (
        "Look for the one change that was meant: where several things differ, the comparison "
        "does not show which of them made the difference."
    )
    return Section("files", "Differences of their files", "Files", look, tuple(content))


def _file_parts(first: str, pair: ComparedPair) -> Iterator[Content]:
    yield element("h3", f"{first} (\N{MINUS SIGN}) and {pair.model} (+)")
    if not pair.files:
        yield element("p", "Their files are equal, or not known.")
    for name, text in pair.files.items():
        yield element("h4", name)
        yield coloured_difference(text.splitlines()[2:])


def _graph(
    title: str,
    runs: Sequence[ComparedRun],
    what: str,
    over: str,
    label: str,
    unit: float,
    decimals: int,
    left: str,
) -> Graph:
    series, steps = [], []
    for number, run in enumerate(runs):
        if not (_has(run, what) and _has(run, over)):
            continue
        at = _values(run, over) / unit
        steps += [float(gap) for gap in np.diff(at) if np.isfinite(gap)]
        color = f"c{number % _COLORS + 1}"
        y = _averaged(_values(run, what), _window(run))
        series.append(Series(run.model, at, y, color, decimals=2 if what == "lap_s" else 1))
    percents = what.endswith("progress")
    return Graph(
        f"{what}-{over}",
        title,
        label,
        series,
        left,
        whole_x=False,
        x_decimals=decimals,
        left_range=(0.0, 102.0) if percents else None,
        # Iterations of trainings do not end together: the nearest ones are read.
        near=max(steps, default=0.5),
        height=360 if what == "progress" and over == "steps" else 260,
    )


def _has(run: ComparedRun, name: str) -> bool:
    return any(value is not None for value in run.curve[name])


def _values(run: ComparedRun, name: str) -> Floats:
    return np.array([np.nan if value is None else value for value in run.curve[name]], np.float64)


def _window(run: ComparedRun) -> int:
    """Iterations in a point: odd, with the point in the middle."""
    return 1 + 2 * (max(run.iterations - 1, 0) // (2 * _POINTS))


def _averaged(values: Floats, window: int) -> Floats:
    if window == 1:
        return values
    known = np.isfinite(values)
    ones = np.ones(window)
    sums = np.convolve(np.where(known, values, 0.0), ones, "same")
    counts = np.convolve(known.astype(np.float64), ones, "same")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known, sums / counts, np.nan)

"""`dr reward`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli.base.errors import Problem, ProblemsError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.cli import console
from drcli.cli.options import Replace, in_options, world_option
from drcli.cli.views import iterations
from drcli.cli.views.iterations import CURVE_COLUMNS
from drcli.cli.views.layout import Fitted, Rows, counted, indented
from drcli.cli.working_folder import working_folder

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.rewards.check import OtherRace, RewardReport
    from drcli.rewards.compare import ComparisonReport
    from drcli.rewards.pictures import PlotReport

with lazy_imports():
    from drcli.config import loading
    from drcli.rewards import check as rewards_check
    from drcli.rewards import compare as rewards_compare
    from drcli.rewards import pictures


# Shows reports about reward functions.


_CURVE_NAME = "steady lap "


def show_check(report: "RewardReport") -> RenderableType:
    state = Text("works", "bold green") if report.works else Text("does not work", "bold red")
    parts: list[RenderableType] = [
        Text.assemble((report.file, "bold"), " ", state),
        Text(f"on {_race(report)}", "dim"),
        *(Text(f"and on {_race(other)}", "dim") for other in report.others),
        _facts(report),
    ]
    if any(driver.total is not None for driver in report.drivers):
        parts += [Text(""), _drivers(report)]
        curve = [value for value in report.curve if value is not None]
        parts.append(Fitted(lambda columns: _curve(curve, columns)))
    for title, style, problems in (
        ("Error", "bold red", report.errors),
        ("Warning", "bold yellow", report.warnings),
    ):
        for problem in problems:
            parts += [Text(""), _problem(problem, title, style)]
    return Group(*parts)


def show_plot(report: "PlotReport") -> RenderableType:
    replaced = " (the old one was replaced)" if report.replaced else ""
    laps = ", ".join(f"{name} {_number(total)}" for name, total in report.laps.items())
    return Group(
        Text.assemble("Picture: ", (report.picture, "bold"), replaced),
        Text(
            f"{report.file} on {report.world}: {_number(report.least)} to "
            f"{_number(report.greatest)} per step on the map."
        ),
        Text(f"Sums: {laps}."),
    )


def comparison(report: "ComparisonReport") -> RenderableType:
    table = Rows(
        ("driver", "steps", "time", "A per lap", "B per lap", "A per step", "B per step"),
        [
            (
                driver.name,
                str(driver.steps),
                f"{driver.seconds:.1f} s",
                _number(driver.first_total),
                _number(driver.second_total),
                _number(driver.first_mean),
                _number(driver.second_mean),
            )
            for driver in report.drivers
        ],
        left=("driver",),
    )
    parts: list[RenderableType] = [
        Text.assemble(("A: ", "bold"), report.first),
        Text.assemble(("B: ", "bold"), report.second),
        Text(f"on {report.world}, {report.race_type}", "dim"),
        Text(""),
        table,
        Text(""),
        Text(_correlation(report)),
    ]
    for name, prefers in (("A", report.first_prefers_fast), ("B", report.second_prefers_fast)):
        if prefers is not None:
            parts.append(Text(f"{name} pays more for {'a fast' if prefers else 'a slow'} lap."))
    if report.places:
        parts += [
            Text(""),
            Text("The steps at which they differ most, with both scaled to the same range:"),
        ]
        parts += [
            indented(f"{place.place}: A {_number(place.first)}, B {_number(place.second)}")
            for place in report.places
        ]
    if report.picture:
        parts.append(Text.assemble("Picture: ", (report.picture, "bold")))
    return Group(*parts)


def _race(report: "RewardReport | OtherRace") -> str:
    direction = ", reversed" if report.reversed else ""
    calls = counted(report.calls, "call")
    return f"{report.world}, {report.race_type}{direction}, {calls}"


def _facts(report: "RewardReport") -> Table:
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    if report.returns:
        table.add_row("returns", ", ".join(report.returns))
    if report.least is not None and report.greatest is not None and report.mean is not None:
        table.add_row("least", f"{_number(report.least.reward)}: {report.least.place}")
        table.add_row("mean", _number(report.mean))
        table.add_row("greatest", f"{_number(report.greatest.reward)}: {report.greatest.place}")
    if report.time is not None:
        table.add_row(
            "time",
            f"{_time(report.time.median_us)} per call, worst {_time(report.time.worst_us)}; "
            f"driving takes {report.time.slower_percent:.1f} % longer",
        )
    reads = [parameter.name for parameter in report.parameters if parameter.read]
    if reads:
        unread = len(report.parameters) - len(reads)
        table.add_row("reads", ", ".join(reads) if unread else f"all {len(reads)} parameters")
    return table


def _drivers(report: "RewardReport") -> Rows:
    return Rows(
        ("driver", "steps", "time", "progress", "ended", "reward", "per step"),
        [
            (
                driver.name,
                str(driver.steps),
                f"{driver.seconds:.1f} s",
                f"{driver.progress:.0f} %",
                driver.end.replace("_", " "),
                "failed" if driver.total is None else _number(driver.total),
                "" if driver.mean is None else _number(driver.mean),
            )
            for driver in report.drivers
        ],
        left=("driver", "ended"),
    )


def _curve(rewards: list[float], columns: int) -> Text:
    width = min(CURVE_COLUMNS, columns - len(_CURVE_NAME))
    return Text.assemble((_CURVE_NAME, "dim"), (iterations.curve(rewards, width), "cyan"))


def _problem(problem: "Problem", title: str, style: str) -> RenderableType:
    return Group(
        Text.assemble((f"{title}: ", style), problem.where, (f" ({problem.rule})", "dim")),
        indented(problem.message),
        indented(Text.assemble(("Try: ", "dim"), problem.remedy)),
    )


def _correlation(report: "ComparisonReport") -> str:
    if report.correlation is None or report.rank_correlation is None:
        return "One of them pays the same everywhere, so there is no correlation."
    return (
        f"Correlation of all steps: {report.correlation:.2f}, of their ranks: "
        f"{report.rank_correlation:.2f} (1: the same goals)."
    )


def _number(value: float) -> str:
    return f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"


def _time(microseconds: float) -> str:
    if microseconds < 1e3:
        return f"{microseconds:.1f} \N{MICRO SIGN}s"
    if microseconds < 1e6:
        return f"{microseconds / 1e3:.1f} ms"
    return f"{microseconds / 1e6:.1f} s"


app = typer.Typer(no_args_is_help=True, help="Check, plot and compare reward functions.")

_File = Annotated[
    Path | None,
    typer.Argument(metavar="FILE", help="A reward function; the one in custom_files/ if left out."),
]
_World = Annotated[str | None, world_option("Track to try it on; DR_WORLD_NAME if left out.", "-w")]


@app.command()
def check(file: _File = None, world: _World = None) -> None:
    """Try a reward function on a drive over the track, and report its problems.

    Finds what `dr validate` and a start find. In addition, scripted drivers drive along the centre
    line, slowly and fast, from border to border, off the road, and into an obstacle if the race has
    any, to show what the function rewards. Exits with code 3 if a training would not start.

    Example: dr-reward check
    """
    with _on_track(world) as settings, console.waiting("Trying the reward function ..."):
        report = rewards_check.check(settings, file, working_folder())
    console.emit(report, show_check(report))
    if not report.works:
        first, *more = report.errors
        raise SettingsError(
            f"{report.file} has {counted(len(report.errors), 'error')}.",
            remedy="Start with the first one." if more else first.remedy,
        )


@app.command()
def plot(
    file: _File = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="The picture.")] = Path("reward.png"),
    world: _World = None,
    force: Replace = False,
) -> None:
    """Draw the rewards of a function on a map of the track and along the lap.

    Example: dr-reward plot -o reward.png
    """
    with _on_track(world) as settings, console.waiting("Trying the reward function ..."):
        report = pictures.plot(settings, file, out, working_folder(), force=force)
    console.emit(report, show_plot(report))


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="A reward function.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    world: _World = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Draw both into this picture.")
    ] = None,
    force: Replace = False,
) -> None:
    """Compare the rewards of two functions for the same drivers.

    Example: dr-reward compare custom_files/reward_function.py other.py -o both.png
    """
    with _on_track(world) as settings, console.waiting("Trying both reward functions ..."):
        report = rewards_compare.compare(
            settings, first, second, out, working_folder(), force=force
        )
    console.emit(report, comparison(report))


@contextmanager
def _on_track(world: str | None) -> "Iterator[Settings]":
    flags = {"DR_WORLD_NAME": world} if world is not None else {}
    try:
        yield loading.load_settings(working_folder(), flags=flags)
    except ProblemsError as error:
        raise in_options(error, {"DR_WORLD_NAME": "--world"}, flags) from None

"""From reports about reward functions to what people see, within 80 columns."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli import sparkline

if TYPE_CHECKING:
    from drcli.reward.check import OtherRace, RewardReport
    from drcli.reward.compare import ComparisonReport
    from drcli.reward.lint import Remark
    from drcli.reward.plot import PlotReport

_CURVE_WIDTH = 54


def check(report: "RewardReport") -> RenderableType:
    """What a check has found out."""
    verdict = Text("works", "bold green") if report.works else Text("does not work", "bold red")
    parts: list[RenderableType] = [
        Text.assemble((report.file, "bold"), " ", verdict),
        Text(f"on {_race(report)}", "dim"),
        *(Text(f"and on {_race(other)}", "dim") for other in report.others),
        _facts(report),
    ]
    if any(driver.total is not None for driver in report.drivers):
        parts += [Text(""), _drivers(report)]
        curve = [value for value in report.curve if value is not None]
        parts.append(
            Text.assemble(("steady lap ", "dim"), (sparkline.curve(curve, _CURVE_WIDTH), "cyan"))
        )
    for title, style, remarks in (
        ("Error", "bold red", report.errors),
        ("Warning", "bold yellow", report.warnings),
    ):
        for remark in remarks:
            parts += [Text(""), _remark(remark, title, style)]
    return Group(*parts)


def plot(report: "PlotReport") -> RenderableType:
    """Where a picture is, and what is on it."""
    replaced = " (the old one was replaced)" if report.replaced else ""
    laps = ", ".join(f"{name} {_number(total)}" for name, total in report.laps.items())
    return Group(
        Text.assemble("Picture: ", (report.picture, "bold"), replaced),
        Text(
            f"{report.file} on {report.world}: {_number(report.least)} to "
            f"{_number(report.greatest)} for a place."
        ),
        Text(f"Sums: {laps}."),
    )


def comparison(report: "ComparisonReport") -> RenderableType:
    """What two functions pay the same drivers."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("driver", "steps", "time", "A a lap", "B a lap", "A a step", "B a step"):
        table.add_column(name, justify="left" if name == "driver" else "right")
    for driver in report.drivers:
        table.add_row(
            driver.name,
            str(driver.steps),
            f"{driver.seconds:.1f} s",
            _number(driver.first_total),
            _number(driver.second_total),
            _number(driver.first_mean),
            _number(driver.second_mean),
        )
    parts: list[RenderableType] = [
        Text.assemble(("A: ", "bold"), report.first),
        Text.assemble(("B: ", "bold"), report.second),
        Text(f"on {report.world}, {report.race_type}", "dim"),
        Text(""),
        table,
        Text(""),
        Text(_likeness(report)),
    ]
    for name, prefers in (("A", report.first_prefers_fast), ("B", report.second_prefers_fast)):
        if prefers is not None:
            parts.append(Text(f"{name} pays {'a fast' if prefers else 'a slow'} lap more."))
    if report.places:
        parts += [Text(""), Text("They differ most, each scaled to what it pays:")]
        parts.append(
            _indented(
                [
                    Text(f"{place.place}: A {_number(place.first)}, B {_number(place.second)}")
                    for place in report.places
                ]
            )
        )
    if report.picture:
        parts.append(Text.assemble("Picture: ", (report.picture, "bold")))
    return Group(*parts)


def _race(report: "RewardReport | OtherRace") -> str:
    direction = ", reversed" if report.reversed else ""
    calls = f"{report.calls:,} call{'s' * (report.calls != 1)}"
    return f"{report.world}, {report.race_type}{direction}, {calls}"


def _facts(report: "RewardReport") -> Table:
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    if report.returns:
        table.add_row("returns", ", ".join(report.returns))
    if report.least is not None and report.greatest is not None and report.mean is not None:
        table.add_row("least", f"{_number(report.least.reward)}: {report.least.place}")
        table.add_row("mean", _number(report.mean))
        table.add_row("greatest", f"{_number(report.greatest.reward)}: {report.greatest.place}")
    if report.time is not None:
        table.add_row(
            "time",
            f"{_time(report.time.median_us)} a call, worst {_time(report.time.worst_us)}; driving "
            f"takes {report.time.slower_percent:.1f} % longer",
        )
    reads = [parameter.name for parameter in report.parameters if parameter.read]
    if reads:
        unread = len(report.parameters) - len(reads)
        table.add_row("reads", ", ".join(reads) if unread else f"all {len(reads)} parameters")
    return table


def _drivers(report: "RewardReport") -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("driver", "steps", "time", "progress", "ended", "reward", "a step"):
        table.add_column(name, justify="left" if name in ("driver", "ended") else "right")
    for driver in report.drivers:
        table.add_row(
            driver.name,
            str(driver.steps),
            f"{driver.seconds:.1f} s",
            f"{driver.progress:.0f} %",
            driver.end.replace("_", " "),
            "failed" if driver.total is None else _number(driver.total),
            "" if driver.mean is None else _number(driver.mean),
        )
    return table


def _remark(remark: "Remark", title: str, style: str) -> RenderableType:
    head = Text.assemble((f"{title}: ", style), remark.where, (f" ({remark.rule})", "dim"))
    lines = [Text(remark.message), Text.assemble(("Try: ", "dim"), remark.remedy)]
    return Group(head, _indented(lines))


def _indented(lines: list[Text]) -> Table:
    """Texts that are broken at the edge of the terminal, below what they belong to."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(width=1)
    table.add_column()
    for line in lines:
        table.add_row("", line)
    return table


def _likeness(report: "ComparisonReport") -> str:
    if report.correlation is None or report.rank_correlation is None:
        return "One of them pays the same everywhere, so there is no likeness to tell."
    return (
        f"Correlation of all steps: {report.correlation:.2f}, of their order "
        f"{report.rank_correlation:.2f} (1: the same wishes)."
    )


def _number(value: float) -> str:
    return f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"


def _time(microseconds: float) -> str:
    if microseconds < 1e3:
        return f"{microseconds:.1f} \N{MICRO SIGN}s"
    if microseconds < 1e6:
        return f"{microseconds / 1e3:.1f} ms"
    return f"{microseconds / 1e6:.1f} s"

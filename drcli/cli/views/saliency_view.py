"""Shows what moved the car."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, counted

if TYPE_CHECKING:
    from drcli.saliency.explain_model import ExplainedStep, SaliencyReport

_ROWS, _COLUMNS = ("far", "middle", "near"), ("left", "centre", "right")


def saliency(report: "SaliencyReport") -> RenderableType:
    number = "" if report.checkpoint is None else f", checkpoint {report.checkpoint}"
    parts: list[RenderableType] = [
        Text(f"{report.model}{number}", style="bold"),
        Text(
            f"on {report.world}: {report.outcome}, {report.progress:.1f} % in "
            f"{report.seconds:.2f} s",
            "dim",
        ),
        Rows(
            ("step", "lap", "action", "steering", "speed", "looks at", "share"),
            [_row(step) for step in report.steps],
            left=("looks at",),
        ),
    ]
    if report.html is not None:
        parts.append(Text.assemble("Page: ", (report.html, "bold")))
    written = [step.picture for step in report.steps if step.picture is not None]
    if written:
        parts.append(Text(f"{counted(len(written), 'picture')}, the first is {written[0]}."))
    return Group(*parts)


def _row(step: "ExplainedStep") -> tuple[str, ...]:
    ninths = next(iter(step.ninths.values()))
    most, row, column = max(
        (share, -row, -column)
        for row, band in enumerate(ninths)
        for column, share in enumerate(band)
    )
    return (
        str(step.step),
        f"{step.progress:.1f} %",
        "-" if step.action is None else str(step.action),
        f"{step.steering_deg:+.1f}°",
        f"{step.speed_mps:.2f} m/s",
        f"{_ROWS[-row]} {_COLUMNS[-column]}" if most > 0 else "nothing",
        f"{most:.0%}",
    )

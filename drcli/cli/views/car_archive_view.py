"""Shows archives for the physical car."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.filesize import decimal
from rich.text import Text

from drcli.cli.views.layout import Rows, counted

if TYPE_CHECKING:
    from drcli.formats.car_actions import CarAction
    from drcli.models.export_car import ArchiveReport, CarReport


def export(report: "CarReport") -> RenderableType:
    would = "Would write" if report.dry_run else "Wrote"
    places = "\n".join(report.files)
    compared = (
        f"Same action as the weights in {report.same_actions} of "
        f"{counted(report.frames, 'frame')} of a drive on {report.world}; greatest difference "
        f"{report.greatest_difference:.1g}."
    )
    title = f"{would} {report.checkpoint} of {report.source}, {decimal(report.size_bytes)}, to"
    return Group(title, Text(places, "bold"), compared, "", _actions(report.actions))


def check(report: "ArchiveReport") -> RenderableType:
    verdict = ("The car loads it", "green") if not report.errors else ("The car refuses it", "red")
    parts: list[RenderableType] = [Text.assemble((report.file, "bold"), ": ", verdict, ".")]
    if report.actions:
        parts += ["", _actions(report.actions)]
    return Group(*parts)


def _actions(actions: "list[CarAction]") -> RenderableType:
    rows = [
        (
            "" if action.index is None else str(action.index),
            f"{action.steering_deg:g}",
            f"{action.speed_mps:g}",
            f"{action.steering:.0%}",
            f"{action.throttle:.1%}",
        )
        for action in actions
    ]
    names = ("action", "steering (deg)", "speed (m/s)", "steering on the car", "throttle")
    return Rows(names, rows)

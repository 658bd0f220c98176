"""Shows settings, problems and edits."""

import re
from collections.abc import Iterable
from itertools import groupby
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.errors import MOST_SHOWN, Problem, shown
from drcli.cli.views.layout import INDENT, counted, fitted, indented
from drcli.config.track_names import ASKED

if TYPE_CHECKING:
    from drcli.checks.check_report import Report
    from drcli.checks.config_check import FullCheck
    from drcli.config.editing import Edit
    from drcli.config.presets import PresetReports, PresetValue
    from drcli.config.settings_report import Value, Values

BELOW_RULE = 8
PLACE_COLUMN = 46
PLACE_COLUMNS = 22
PLACE_INDENT = 4


def check(report: "FullCheck") -> RenderableType:
    lines: list[RenderableType] = []
    for problem in report.errors[:MOST_SHOWN]:
        lines.append(Text.assemble(("Error: ", "bold red"), str(problem)))
        lines.append(indented(Text(f"Try: {problem.remedy}", style="dim")))
    if len(report.errors) > MOST_SHOWN:
        lines.append(Text(f"And {len(report.errors) - MOST_SHOWN:,} more like these."))
    lines += [Text.assemble(("Warning: ", "yellow"), text) for text in report.warnings]
    if report.without_effect:
        lines.append(Text("Accepted without effect:"))
    for group in report.without_effect:
        lines.append(indented(f"{group.reason}:"))
        lines.append(indented(Text(", ".join(group.names), style="dim"), 2 * INDENT))
    style = "bold red" if report.errors else "green"
    counts = f"{counted(len(report.errors), 'error')}, {counted(len(report.warnings), 'warning')}."
    lines.append(Text(f"Settings: {counts}", style=style))
    if report.rules is not None:
        lines.append(problems(report.rules))
    return Group(*lines)


def edit(report: "Edit") -> RenderableType:
    lines = []
    for change in report.changes:
        before = "" if change.before is None else f"  (was {shown(change.before) or 'empty'})"
        lines.append(Text(f"{change.file}: {change.name}={change.after}{before}"))
    return Group(*lines)


@fitted
def values(columns: int, report: "Values") -> RenderableType:
    lines: list[RenderableType] = []
    for title, group in groupby(report.settings, lambda value: value.group):
        lines += [Text(f"# {title}", style="bold"), *_lines(group, columns), Text("")]
    for worker in report.workers:
        lines += [Text(f"# Worker {worker.worker}", style="bold")]
        lines += [*_lines(worker.settings, columns), Text("")]
    if not lines:
        return Text("Every setting has its default.")
    return Group(*lines[:-1])


@fitted
def explained(columns: int, report: "Values") -> RenderableType:
    lines: list[RenderableType] = []
    for value in report.settings:
        lines += [*_lines([value], columns), indented(value.meaning)]
        default = f" Default: {value.default}." if value.default else ""
        lines.append(indented(Text(f"Allowed: {value.expected}.{default}", style="dim")))
        if value.reason:
            lines.append(indented(Text(f"No effect here: {value.reason}.", style="yellow")))
    for worker in report.workers:
        lines += _lines(worker.settings, columns)
    return Group(*lines)


def presets(report: "PresetReports", *, in_full: bool) -> RenderableType:
    lines: list[RenderableType] = []
    for preset in report.presets:
        lines += [Text(preset.name, style="bold"), indented(preset.summary)]
        lines.append(indented(Text(f"Files: {', '.join(preset.files) or 'none'}.", style="dim")))
        for reason, group in groupby(preset.settings, lambda value: value.reason):
            if not in_full:
                break
            lines += [Text(""), *([indented(Text(f"# {reason}", style="dim"))] if reason else [])]
            lines += [part for value in group for part in _of_preset(value)]
        lines.append(Text(""))
    if not in_full:
        lines.append(Text("`dr config preset NAME` shows the settings of one.", style="dim"))
        return Group(*lines)
    return Group(*lines[:-1])


def _of_preset(value: "PresetValue") -> list[RenderableType]:
    yours = ""
    if value.present is not None and value.present != value.value:
        yours = f"  # here {shown(value.present) or 'empty'}, {value.source}"
    line = Text.assemble(f"{value.name}={value.value}", (yours, "yellow"))
    return [indented(line), indented(Text(value.meaning, style="dim"), 2 * INDENT)]


def problems(found: "Report") -> RenderableType:
    parts: list[RenderableType] = []
    for title, style, group in (
        ("Errors", "bold red", found.errors),
        ("Warnings", "yellow", found.warnings),
        ("Notes", "bold", found.notes),
    ):
        if group:
            parts.append(Text(title, style=style))
            parts += [part for item in group for part in _problem(item)]
    if found.skipped:
        parts.append(Text("Not tried", style="bold"))
        parts += [indented(f"{', '.join(item.rules)}: {item.reason}") for item in found.skipped]
    parts.append(Text(_sum(found), style="bold green" if found.ok else "bold red"))
    return Group(*parts)


def _problem(item: "Problem") -> list[RenderableType]:
    lines = [indented(f"{item.rule}  {item.where}"), indented(item.message, BELOW_RULE)]
    if item.remedy:
        lines.append(indented(Text(f"Try: {item.remedy}", style="dim"), BELOW_RULE))
    return lines


def _sum(found: "Report") -> str:
    counts = f"{counted(len(found.errors), 'error')}, {counted(len(found.warnings), 'warning')}."
    if not found.ok and all(item.rule == "V-13" for item in found.errors):
        return f"{counts} A training can start when the present one has ended."
    if not found.ok and all(ASKED in item.remedy for item in found.errors):
        return f"{counts} A training would not start, except on a terminal, where it asks first."
    if not found.ok:
        return f"{counts} A training would not start."
    if found.notes:
        return f"{counts} A training can start with what the notes say."
    return f"{counts} A training can start."


def _lines(values: "Iterable[Value]", columns: int) -> list[RenderableType]:
    column = min(PLACE_COLUMN, columns - PLACE_COLUMNS)
    lines: list[RenderableType] = []
    for value in values:
        quote = '"' if re.search(r"\s|#", value.value) else ""
        written = f"{value.name}={quote}{value.value}{quote}"
        place = f"# {value.source}" + (", no effect" if value.reason else "")
        style = "" if value.changed else "dim"
        if max(len(written), column) + 1 + len(place) <= columns:
            written = written.ljust(column)
        if len(written) + 1 + len(place) <= columns:
            lines.append(Text.assemble((written, style), " ", (place, "dim")))
        else:
            lines += [Text(written, style), indented(Text(place, "dim"), PLACE_INDENT)]
    return lines

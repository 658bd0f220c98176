"""How settings look: values with their places, problems, edits."""

import re
from collections.abc import Iterable
from itertools import groupby
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.problems import MOST_SHOWN, shown
from drcli.cli.views import problems_view
from drcli.cli.views.layout import INDENT, Fitted, indented

if TYPE_CHECKING:
    from drcli.checks.config_check import FullCheck
    from drcli.config.editing import Edit
    from drcli.config.settings_report import Value, Values

PLACE_COLUMN = 46
"""Column of a value's place, unless the value is longer or the terminal is narrow."""

PLACE_COLUMNS = 22
"""Columns that most places need."""

PLACE_INDENT = 4
"""Indent of a place on a line of its own, where the value's line has no room."""


def values(report: "Values") -> RenderableType:
    """All values, as lines of a settings file with their places behind."""
    return Fitted(lambda columns: _values(report, columns))


def explained(report: "Values") -> RenderableType:
    """Some values, each with what it means and what may be written."""
    return Fitted(lambda columns: _explained(report, columns))


def check(report: "FullCheck") -> RenderableType:
    """All problems of the settings, and what the other rules found."""
    lines: list[RenderableType] = []
    for finding in report.errors[:MOST_SHOWN]:
        lines.append(Text.assemble(("Error: ", "bold red"), str(finding)))
        lines.append(indented(Text(f"Try: {finding.remedy}", style="dim")))
    if len(report.errors) > MOST_SHOWN:
        lines.append(Text(f"And {len(report.errors) - MOST_SHOWN:,} more like these."))
    lines += [Text.assemble(("Warning: ", "yellow"), text) for text in report.warnings]
    if report.without_effect:
        lines.append(Text("Accepted without effect:"))
    for group in report.without_effect:
        lines.append(indented(f"{group.reason}:"))
        lines.append(indented(Text(", ".join(group.names), style="dim"), 2 * INDENT))
    style = "bold red" if report.errors else "green"
    counts = f"{_count(report.errors, 'error')}, {_count(report.warnings, 'warning')}."
    lines.append(Text(f"Settings: {counts}", style=style))
    if report.rules is not None:
        lines.append(problems_view.report(report.rules))
    return Group(*lines)


def edit(report: "Edit") -> RenderableType:
    """What was changed, a line each."""
    lines = []
    for change in report.changes:
        before = "" if change.before is None else f"  (was {shown(change.before) or 'empty'})"
        lines.append(Text(f"{change.file}: {change.name}={change.after}{before}"))
    return Group(*lines)


def _values(report: "Values", columns: int) -> RenderableType:
    lines: list[RenderableType] = []
    for title, group in groupby(report.settings, lambda value: value.group):
        lines += [Text(f"# {title}", style="bold"), *_lines(group, columns), Text("")]
    for worker in report.workers:
        lines += [Text(f"# Worker {worker.worker}", style="bold")]
        lines += [*_lines(worker.settings, columns), Text("")]
    if not lines:
        return Text("Every setting has its default.")
    return Group(*lines[:-1])


def _explained(report: "Values", columns: int) -> RenderableType:
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


def _lines(values: "Iterable[Value]", columns: int) -> list[RenderableType]:
    """Values as they would be written, each with the place it comes from."""
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


def _count(things: "tuple[object, ...]", word: str) -> str:
    number = len(things) or "no"
    return f"{number} {word}" if len(things) == 1 else f"{number} {word}s"

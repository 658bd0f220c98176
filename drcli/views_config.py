"""From reports about settings to what people see, within 80 columns where the values allow."""

import re
import textwrap
from itertools import groupby
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.findings import MOST_SHOWN, shown

if TYPE_CHECKING:
    from drcli.settings.editing import Edit
    from drcli.settings.inspection import Check, Value, Values

WIDTH = 79

PLACE_COLUMN = 46
"""Where the place of a value stands, unless the value is longer."""


def values(report: "Values") -> RenderableType:
    """All values, as lines of a settings file with their places behind."""
    lines: list[RenderableType] = []
    for title, group in groupby(report.settings, lambda value: value.group):
        lines += [Text(f"# {title}", style="bold"), *map(_line, group), Text("")]
    for worker in report.workers:
        lines += [Text(f"# Worker {worker.worker}", style="bold")]
        lines += [*map(_line, worker.settings), Text("")]
    if not lines:
        return Text("Every setting has its default.")
    return Group(*lines[:-1])


def explained(report: "Values") -> RenderableType:
    """Some values, each with what it means and what may be written."""
    lines: list[RenderableType] = []
    for value in report.settings:
        lines += [_line(value), Text(f"  {value.meaning}")]
        default = f" Default: {value.default}." if value.default else ""
        lines.append(Text(f"  May be {value.expected}.{default}", style="dim"))
        if value.reason:
            lines.append(Text(f"  No effect here: {value.reason}.", style="yellow"))
    for worker in report.workers:
        lines += map(_line, worker.settings)
    return Group(*lines)


def check(report: "Check") -> RenderableType:
    """Everything there is to say about the settings."""
    lines: list[Text] = []
    for finding in report.errors[:MOST_SHOWN]:
        lines.append(Text.assemble(("Error: ", "bold red"), str(finding)))
        lines.append(Text(f"  Try: {finding.remedy}", style="dim"))
    if len(report.errors) > MOST_SHOWN:
        lines.append(Text(f"And {len(report.errors) - MOST_SHOWN:,} more like these."))
    lines += [Text.assemble(("Warning: ", "yellow"), text) for text in report.warnings]
    if report.without_effect:
        lines.append(Text("Accepted without effect:"))
    for group in report.without_effect:
        lines += [Text(f"  {group.reason}:"), Text(_wrapped(group.names), style="dim")]
    style = "green" if report.valid else "bold red"
    counts = f"{_count(report.errors, 'error')}, {_count(report.warnings, 'warning')}."
    lines.append(Text(counts.capitalize(), style=style))
    return Group(*lines)


def edit(report: "Edit") -> RenderableType:
    """What was changed, a line each."""
    lines = []
    for change in report.changes:
        before = "" if change.before is None else f"  (was {shown(change.before) or 'empty'})"
        lines.append(Text(f"{change.file}: {change.name}={change.after}{before}"))
    return Group(*lines)


def _line(value: "Value") -> Text:
    """One value as it would be written, and where it comes from."""
    quote = '"' if re.search(r"\s|#", value.value) else ""
    written = f"{value.name}={quote}{value.value}{quote}"
    place = f"# {value.source}" + (", no effect" if value.reason else "")
    style = "" if value.changed else "dim"
    return Text.assemble((written.ljust(PLACE_COLUMN), style), " ", (place, "dim"))


def _wrapped(names: "tuple[str, ...]") -> str:
    """Names on as many indented lines as they need."""
    indent = "    "
    return textwrap.fill(", ".join(names), WIDTH, initial_indent=indent, subsequent_indent=indent)


def _count(things: "tuple[object, ...]", word: str) -> str:
    number = len(things) or "no"
    return f"{number} {word}" if len(things) == 1 else f"{number} {word}s"

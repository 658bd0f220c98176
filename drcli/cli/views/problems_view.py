"""How the report of the rules looks."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import indented

if TYPE_CHECKING:
    from drcli.base.problems import Problem
    from drcli.checks.check_report import Report

BELOW_RULE = 8
"""Columns before what is wrong, below its rule."""


def report(found: "Report") -> RenderableType:
    """Errors, warnings, what was not tried, and how many there are of each."""
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
    counts = f"{_count(len(found.errors), 'error')}, {_count(len(found.warnings), 'warning')}."
    if not found.ok:
        return f"{counts} A training would not start."
    if any(item.rule == "V-13" for item in found.warnings):
        return f"{counts} A training can start when the present one has ended."
    if found.notes:
        return f"{counts} A training can start with what the notes say."
    return f"{counts} A training can start."


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"

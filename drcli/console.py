"""The one place that prints: results to stdout, everything else to stderr."""

import dataclasses
import json
import sys
from typing import Any

from rich.console import Console, RenderableType
from rich.markup import escape

out = Console(highlight=False)
"""Results."""

err = Console(stderr=True, highlight=False)
"""Hints, warnings, progress and failures."""


def emit(report: Any, rendered: RenderableType, *, as_json: bool) -> None:
    """Print a result: for people, or as one JSON object on the last line of stdout.

    Args:
        report: A dataclass.
        rendered: The same for people.
        as_json: Which of the two.
    """
    if as_json:
        print(json.dumps(dataclasses.asdict(report)), flush=True)
    else:
        out.print(rendered)


def say(text: str) -> None:
    """A word on what happens."""
    err.print(escape(text), soft_wrap=True)


def warn(text: str) -> None:
    """Something that is allowed and may surprise."""
    err.print(f"[yellow]Warning:[/] {escape(text)}", soft_wrap=True)


def suggest(title: str, commands: list[tuple[str, str]]) -> None:
    """Commands to paste, each with what it does."""
    err.print(escape(title))
    width = max(len(command) for command, _ in commands)
    for command, purpose in commands:
        err.print(f"  [bold]{escape(command.ljust(width))}[/]  [dim]{escape(purpose)}[/]")


def fail(message: str, remedy: str) -> None:
    """A failure and what to do about it."""
    err.print(f"[bold red]Error:[/] {escape(message)}", soft_wrap=True)
    if remedy:
        err.print(f"  [dim]Try:[/] {escape(remedy)}", soft_wrap=True)


def is_live() -> bool:
    """Whether somebody looks at a terminal that can redraw itself."""
    return err.is_terminal and not err.is_dumb_terminal and sys.stdin.isatty()

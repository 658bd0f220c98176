"""The one place that prints: results to stdout, everything else to stderr."""

import dataclasses
import json
import math
import os
import sys
from typing import Any, NoReturn

from rich.console import Console, RenderableType
from rich.markup import escape


class _Console(Console):
    """A console whose reader may leave: `dr-status | head -1` is no failure."""

    def on_broken_pipe(self) -> None:
        _end_quietly()


out = _Console(highlight=False)
"""Results."""

err = _Console(stderr=True, highlight=False)
"""Hints, warnings, progress and failures."""


def emit(report: Any, rendered: RenderableType, *, as_json: bool) -> None:
    """Print a result: for people, or as one JSON object on the last line of stdout.

    Args:
        report: A dataclass. Its properties become keys beside its fields.
        rendered: The same for people.
        as_json: Which of the two.
    """
    if as_json:
        write(json.dumps(_plain(_with_properties(report)), allow_nan=False) + "\n")
    else:
        out.print(rendered, soft_wrap=True)


def write(text: str) -> None:
    """Text that is itself the result, such as a log, exactly as it is."""
    try:
        print(text, end="", flush=True)
    except BrokenPipeError:
        _end_quietly()


def say(text: str) -> None:
    """A word on what happens."""
    err.print(text, markup=False, soft_wrap=True)


def warn(text: str) -> None:
    """Something that is allowed and may surprise."""
    err.print(f"[yellow]Warning:[/] {escape(text)}", soft_wrap=True)


def confirm(question: str) -> bool:
    """Ask for a yes; anything else is a no, and so is an input that has ended."""
    err.print(f"{question} [y/N] ", end="", markup=False, soft_wrap=True)
    return sys.stdin.readline().strip().casefold() in ("y", "yes")


def suggest(commands: list[tuple[str, str]]) -> None:
    """Commands to paste next, each with what it does."""
    err.print("Next:")
    width = max(len(command) for command, _ in commands)
    for command, purpose in commands:
        err.print(
            f"  [bold]{escape(command.ljust(width))}[/]  [dim]# {escape(purpose)}[/]",
            soft_wrap=True,
        )


def fail(message: str, remedy: str) -> None:
    """A failure and what to do about it."""
    err.print(f"[bold red]Error:[/] {escape(message)}", soft_wrap=True)
    if remedy:
        err.print(f"  [dim]Try:[/] {escape(remedy)}", soft_wrap=True)


def is_live() -> bool:
    """Whether somebody looks at a terminal that can redraw itself.

    Streams are asked themselves, because FORCE_COLOR makes Rich take a pipe for a terminal.
    """
    attached = sys.stdin.isatty() and sys.stderr.isatty()
    return attached and not err.is_dumb_terminal and not os.environ.get("NO_COLOR")


def _with_properties(report: Any) -> dict[str, Any]:
    names = [name for name, value in vars(type(report)).items() if isinstance(value, property)]
    return {**dataclasses.asdict(report), **{name: getattr(report, name) for name in names}}


def _plain(value: Any) -> Any:
    """The same without NaN and infinities, which JSON does not know: they become null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _end_quietly() -> NoReturn:
    """End without a word: the reader of a pipe has seen enough."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        if not stream.isatty():
            os.dup2(nowhere, stream.fileno())
    raise SystemExit(0)

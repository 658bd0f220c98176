"""The one place that prints: results to stdout, everything else to stderr."""

import dataclasses
import json
import math
import os
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import takewhile, zip_longest
from typing import IO, Any, Literal

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.segment import Segment, Segments
from rich.text import Text

from drcli.base import verbosity
from drcli.base.errors import OutputLost
from drcli.base.problems import Problem
from drcli.config import activation

Advance = Callable[[int], None]
"""Takes how much more is done."""


class _Console(Console):
    """A console whose reader may leave: `dr-status | head -1` ends as without `head`."""

    def on_broken_pipe(self) -> None:
        _lose_reader(self.file)


NARROWEST = 40
"""Columns below which nothing of ours can be read; COLUMNS=0 means that nobody knows."""

BOUNDLESS = 100_000
"""Columns of a pipe: nothing is folded, so that programs find a row of a table in one line."""

_UNKNOWN_COLUMNS = 80


def fresh(*, stderr: bool = False) -> Console:
    """A console for the environment as it is now; without any escape sequence under NO_COLOR."""
    known = os.environ.get("COLUMNS", "")
    too_narrow = known.isdigit() and int(known) < NARROWEST
    return _Console(
        stderr=stderr,
        highlight=False,
        emoji=False,
        color_system=None if os.environ.get("NO_COLOR") else "auto",
        width=_UNKNOWN_COLUMNS if too_narrow else None,
    )


out = fresh()
"""Results."""

err = fresh(stderr=True)
"""Hints, warnings, progress and failures."""

_reader_has_left = False


def emit(report: Any, rendered: RenderableType, *, as_json: bool, folded: bool = True) -> None:
    """Print a result: for people, or as one JSON object on the last line of stdout.

    Args:
        report: A dataclass. Its properties become keys beside its fields.
        rendered: The same for people: folded at the edge of a terminal, whole lines in a pipe. No
            line ends in a blank.
        as_json: Which of the two.
        folded: Whether it is folded on a terminal too: an address in two pieces cannot be pasted.
    """
    if as_json:
        write(json.dumps(_plain(_with_properties(report)), allow_nan=False) + "\n")
    else:
        with _printing():
            out.print(_fitted(rendered, columns() if folded else BOUNDLESS), soft_wrap=True, end="")
            out.file.flush()


def columns() -> int:
    """Columns that results may fill: those of the terminal, or no end of them in a pipe.

    Rich is not asked, which takes every dumb terminal for one of 80 columns.
    """
    if not out.file.isatty():
        return BOUNDLESS
    known = shutil.get_terminal_size().columns
    return known if known >= NARROWEST else _UNKNOWN_COLUMNS


def write(text: str, *, followed: bool = False) -> None:
    """Text that is itself the result, such as a log, exactly as it is.

    Args:
        text: The text.
        followed: Whether it is printed for its reader's sake alone: the command ends, and that is
            no failure, when the reader of the pipe has left.
    """
    with _printing():
        print(text, end="", flush=True)
    if followed and reader_has_left():
        raise SystemExit(0)


def reader_has_left() -> bool:
    """Whether a pipe was closed that something was printed to: what follows goes nowhere."""
    return _reader_has_left


def say(text: str) -> None:
    """A word on what happens, which --quiet spares."""
    if not verbosity.quiet:
        err.print(text, markup=False, soft_wrap=True)


def warn(text: str) -> None:
    """Something that is allowed and may surprise."""
    err.print(f"[yellow]Warning:[/] {escape(text)}", soft_wrap=True)


@contextmanager
def progress(what: str, total: int, unit: Literal["bytes", "calls"]) -> Iterator[Advance]:
    """A bar on a terminal, nothing elsewhere.

    Args:
        what: What is being done, as `Uploading model`.
        total: How much there is to do.
        unit: What is counted.

    Yields:
        A function that takes how much more is done.
    """
    if not is_live():
        yield lambda amount: None
        return
    from rich.progress import BarColumn, DownloadColumn, MofNCompleteColumn, Progress, TextColumn

    done = DownloadColumn() if unit == "bytes" else MofNCompleteColumn()
    with Progress(TextColumn("{task.description}"), BarColumn(), done, console=err) as bars:
        task = bars.add_task(escape(what), total=total)
        yield lambda amount: bars.advance(task, amount)


@contextmanager
def waiting(what: str, *, only_live: bool = False) -> Iterator[None]:
    """Say what is waited for: a spinner on a terminal, one line elsewhere.

    Args:
        what: As "Checking the model ...".
        only_live: Nothing elsewhere: for commands whose first line scripts look at.
    """
    if not is_live():
        if not only_live:
            say(what)
        yield
        return
    with err.status(escape(what)):
        yield


def suggest(commands: list[tuple[str, str]], *, elsewhere: bool = False) -> None:
    """Commands to paste next, each below what it does; --quiet spares them.

    A command has a line of its own, because zsh takes a comment behind it for arguments. Ours are
    repeated with the variables that this one was called with, as far as they say where things are.

    Args:
        commands: Each with its purpose.
        elsewhere: They are for another working folder or experiment than this command was.
    """
    if verbosity.quiet:
        return
    places = {} if elsewhere else activation.places(os.environ)
    err.print("Next:")
    for command, purpose in commands:
        line = escape(_repeated(command, places))
        err.print(f"  [dim]{escape(purpose)}:[/]\n    [bold]{line}[/]", soft_wrap=True)


def fail(message: str, remedy: str) -> None:
    """A failure and what to do about it, or several failures.

    Args:
        message: A sentence, or several, a line each.
        remedy: What to do. Where it has several lines, they belong to the lines of the message, in
            the same order.
    """
    pairs = [(message, remedy)]
    if "\n" in remedy:
        pairs = list(zip_longest(message.splitlines(), remedy.splitlines(), fillvalue=""))
    for sentence, what_to_do in pairs:
        err.print(f"[bold red]Error:[/] {escape(sentence)}", soft_wrap=True)
        if what_to_do:
            err.print(f"  [dim]Try:[/] {escape(what_to_do)}", soft_wrap=True)


def is_live() -> bool:
    """Whether somebody looks at a terminal that can redraw itself.

    Streams are asked themselves, because FORCE_COLOR makes Rich take a pipe for a terminal.
    """
    attached = sys.stdin.isatty() and sys.stderr.isatty() and not verbosity.quiet
    return attached and not err.is_dumb_terminal and not os.environ.get("NO_COLOR")


def _repeated(command: str, variables: Mapping[str, str]) -> str:
    """A command of ours with these variables before it, except those that it sets itself."""
    words = shlex.split(command)
    own = [word.partition("=")[0] for word in takewhile(lambda word: "=" in word, words)]
    if not f"{words[len(own)]}-".startswith("dr-"):
        return command
    before = [f"{n}={shlex.quote(v)}" for n, v in variables.items() if n not in own]
    return " ".join([*before, command])


def _fitted(rendered: RenderableType, width: int) -> Segments:
    """What a renderable looks like in so many columns, without blanks at the end of lines."""
    view = Text(rendered) if isinstance(rendered, str) else rendered
    lines = out.render_lines(view, out.options.update(max_width=width), pad=False)
    return Segments([segment for line in lines for segment in (*_trimmed(line), Segment.line())])


def _trimmed(line: list[Segment]) -> list[Segment]:
    """A line without the blanks that tables put at its end."""
    while line and not line[-1].text.strip():
        line = line[:-1]
    if not line:
        return []
    last = line[-1]
    return [*line[:-1], Segment(last.text.rstrip(), last.style)]


@contextmanager
def _printing() -> Iterator[None]:
    """While a result is printed, which a reader who leaves or a full disk may end."""
    try:
        yield
    except BrokenPipeError:
        _lose_reader(sys.stdout)
    except OSError as error:
        _forget(sys.stdout)
        raise OutputLost(
            f"The result cannot be written to standard output: {error.strerror or error}.",
            remedy="Make room there, or send the output elsewhere.",
        ) from None


def _with_properties(report: Any) -> dict[str, Any]:
    names = [field.name for field in dataclasses.fields(report)]
    names += [name for name, value in vars(type(report)).items() if isinstance(value, property)]
    return {name: getattr(report, name) for name in names}


def _plain(value: Any) -> Any:
    """The same without NaN and infinities, which JSON does not know: they become null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Problem):
        return value.as_json()
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return {field.name: _plain(getattr(value, field.name)) for field in fields}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _lose_reader(stream: IO[str]) -> None:
    """Go on without a word: the reader has seen enough, and the exit code still counts."""
    global _reader_has_left
    _reader_has_left = True
    _forget(stream)


def _forget(stream: IO[str]) -> None:
    """Let what is still to be printed go nowhere, or Python tries once more when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())

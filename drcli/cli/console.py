"""Prints: results to stdout, everything else to stderr."""

import errno
import json
import os
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from itertools import takewhile, zip_longest
from typing import IO, Any, Literal

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.segment import Segment, Segments
from rich.text import Text

from drcli.base.errors import OutputLost
from drcli.base.plain_json import keys_of
from drcli.config import activation

Advance = Callable[[int], None]
"""Takes the amount done since its last call."""


class _Console(Console):
    """A console that survives a closed pipe: `dr-status | head -1` ends as without `head`.

    It also survives a closed terminal: what goes on without one has its own exit code.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print, or drop it if the terminal is gone."""
        try:
            super().print(*objects, **options)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            _discard(self.file)

    def on_broken_pipe(self) -> None:
        _discard(self.file)


NARROWEST = 40
"""Narrowest width for readable output; COLUMNS=0 means unknown."""

BOUNDLESS = 100_000
"""Width of a pipe: nothing is folded, so that programs find each row in one line."""

_UNKNOWN_COLUMNS = 80
_LONG_WORD = 24


def fresh(*, stderr: bool = False) -> Console:
    """A console for the environment as it is now; with NO_COLOR, without escape sequences."""
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

quiet = False
"""Whether only results, warnings and failures are printed."""

_reader_has_left = False


def emit(
    report: Any, rendered: RenderableType | None, *, as_json: bool, folded: bool = True
) -> None:
    """Print a result: for people, or as one JSON object on the last line of stdout.

    Args:
        report: A dataclass. Its fields and properties become keys.
        rendered: The same for people: folded at the edge of a terminal, whole lines in a pipe. With
            None, people see nothing.
        as_json: Whether to print JSON.
        folded: Whether to fold it on a terminal; an address in two pieces cannot be pasted.
    """
    if as_json:
        write(json.dumps(keys_of(report), allow_nan=False) + "\n")
    elif rendered is not None:
        with _printing():
            out.print(_fitted(rendered, columns() if folded else BOUNDLESS), soft_wrap=True, end="")
            out.file.flush()


def columns() -> int:
    """Width of the terminal, or unlimited in a pipe. Rich gives every dumb terminal 80 columns."""
    if not out.file.isatty():
        return BOUNDLESS
    known = shutil.get_terminal_size().columns
    return known if known >= NARROWEST else _UNKNOWN_COLUMNS


def write(text: str, *, followed: bool = False) -> None:
    """Print a result unchanged, such as a log.

    A command that is `followed` ends with code 0 when the pipe is closed.
    """
    with _printing():
        print(text, end="", flush=True)
    if followed and reader_has_left():
        raise SystemExit(0)


def reader_has_left() -> bool:
    """Whether the pipe that results go to was closed."""
    return _reader_has_left


def say(text: str) -> None:
    """Print what is happening, unless --quiet is given."""
    if not quiet:
        err.print(text, markup=False, soft_wrap=True)


def warn(*texts: str) -> None:
    """Print warnings: what is allowed but may surprise."""
    for text in texts:
        err.print(f"[yellow]Warning:[/] {escape(text)}", soft_wrap=_in_one_piece(text))


@contextmanager
def progress(what: str, total: int, unit: Literal["bytes", "calls"]) -> Iterator[Advance]:
    """Show a progress bar on a terminal, nothing elsewhere, for work such as "Uploading model"."""
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
    """Show what the command is waiting for: a spinner on a terminal, one line elsewhere.

    With `only_live` there is no line, for commands whose first line is read by scripts.
    """
    if not is_live() and not only_live:
        say(what)
    with err.status(escape(what)) if is_live() else nullcontext():
        yield


def suggest(commands: list[tuple[str, str]], *, elsewhere: bool = False) -> None:
    """Print commands to paste next, each below its purpose, unless --quiet is given.

    A command has its own line, because zsh takes a comment after it for arguments. Our commands get
    the variables that name folders or files in this call, unless they are for a place `elsewhere`.
    """
    if quiet:
        return
    places = {} if elsewhere else activation.places(os.environ)
    err.print("Next:")
    for command, purpose in commands:
        line = escape(_repeated(command, places))
        err.print(f"  [dim]{escape(purpose)}:[/]\n    [bold]{line}[/]", soft_wrap=True)


def fail(message: str, remedy: str) -> None:
    """Print an error and what to do about it. Several of both stand on lines in the same order."""
    pairs = [(message, remedy)]
    if "\n" in remedy:
        pairs = list(zip_longest(message.splitlines(), remedy.splitlines(), fillvalue=""))
    for sentence, what_to_do in pairs:
        err.print(f"[bold red]Error:[/] {escape(sentence)}", soft_wrap=_in_one_piece(sentence))
        if what_to_do:
            one_piece = _in_one_piece(what_to_do)
            err.print(f"  [dim]Try:[/] {escape(what_to_do)}", soft_wrap=one_piece)


def _in_one_piece(text: str) -> bool:
    """Whether not to break a text between words: in a pipe, or with a command or path to copy."""
    long = any(len(word) > _LONG_WORD for word in text.split())
    return long or "`" in text or not err.file.isatty()


def is_live() -> bool:
    """Whether a terminal can be redrawn. With FORCE_COLOR, Rich takes a pipe for a terminal."""
    attached = sys.stdin.isatty() and sys.stderr.isatty() and not quiet
    return attached and not err.is_dumb_terminal and not os.environ.get("NO_COLOR")


def _repeated(command: str, variables: Mapping[str, str]) -> str:
    """One of our commands with these variables before it, except those that it sets itself."""
    words = shlex.split(command)
    own = [word.partition("=")[0] for word in takewhile(lambda word: "=" in word, words)]
    if not f"{words[len(own)]}-".startswith("dr-"):
        return command
    before = [f"{n}={shlex.quote(v)}" for n, v in variables.items() if n not in own]
    return " ".join([*before, command])


def _fitted(rendered: RenderableType, width: int) -> Segments:
    """A renderable as segments for this width, without spaces at line ends."""
    view = Text(rendered) if isinstance(rendered, str) else rendered
    lines = out.render_lines(view, out.options.update(max_width=width), pad=False)
    return Segments([segment for line in lines for segment in _trimmed(line)])


def _trimmed(line: list[Segment]) -> list[Segment]:
    """A line and its end, without the spaces that tables add."""
    while line and not line[-1].text.strip():
        line = line[:-1]
    if not line:
        return [Segment.line()]
    last = line[-1]
    return [*line[:-1], Segment(last.text.rstrip(), last.style), Segment.line()]


@contextmanager
def _printing() -> Iterator[None]:
    """Handle a closed pipe and a full disk while a result is printed."""
    try:
        yield
    except BrokenPipeError:
        _discard(sys.stdout)
    except OSError as error:
        _discard(sys.stdout)
        raise OutputLost(
            f"The result cannot be written to standard output: {error.strerror or error}.",
            remedy="Free some disk space, or send the output elsewhere.",
        ) from None


def _discard(stream: IO[str]) -> None:
    """Discard further output; otherwise Python would try to write it again when it exits."""
    global _reader_has_left
    _reader_has_left = True
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())

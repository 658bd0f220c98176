"""Prints: results to stdout, everything else to stderr."""

import errno
import json
import os
import re
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from itertools import takewhile, zip_longest
from typing import IO, Any, Literal

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.segment import Segment, Segments
from rich.text import Text

from drcli.base.errors import OutputLost
from drcli.base.installation import lazy_imports
from drcli.base.json_record import keys_of
from drcli.config import activation

with lazy_imports():
    from rich import progress as rich_progress

Advance = Callable[[int], None]


class _Console(Console):
    """Survives a closed terminal, or a closed pipe as in `dr-status | head -1`."""

    def print(self, *objects: Any, **options: Any) -> None:
        try:
            super().print(*objects, **options)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            _discard(self.file)

    def on_broken_pipe(self) -> None:
        _discard(self.file)


NARROWEST = 40
BOUNDLESS = 100_000
"""Width of a pipe: a row is one line."""

_UNKNOWN_COLUMNS = 80
_COMMAND, _NO_BREAK = re.compile(r"`[^`\n]*`"), "\u00a0"


def fresh(*, stderr: bool = False) -> Console:
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
err = fresh(stderr=True)
quiet, as_json = False, False
"""Options of the command that runs."""

emitted = False
"""Whether its JSON object is printed."""

_reader_has_left = False


def emit(report: Any, rendered: RenderableType | None, *, folded: bool = True) -> None:
    """Print a result: for people, or with --json as one JSON object on the last line of stdout.

    Without `folded`, an address stays in one piece.
    """
    if as_json:
        _emit_object(keys_of(report))
    elif rendered is not None:
        with _printing():
            out.print(_fitted(rendered, columns() if folded else BOUNDLESS), soft_wrap=True, end="")
            out.file.flush()


def _emit_object(report: Any) -> None:
    global emitted
    emitted = True
    write(json.dumps(report, allow_nan=False) + "\n")


def emit_failure(message: str, remedy: str, code: int) -> None:
    """Print the JSON object of a failure, unless the command has printed its own."""
    if not emitted:
        _emit_object({"error": message, "remedy": remedy, "code": code})


def on_screen() -> bool:
    """Whether a person sees the result, so that nothing of it has to be said again."""
    return out.file.isatty() and not as_json


def columns() -> int:
    """Rich gives every dumb terminal 80 columns."""
    if not out.file.isatty():
        return BOUNDLESS
    known = shutil.get_terminal_size().columns
    return known if known >= NARROWEST else _UNKNOWN_COLUMNS


def write(text: str, *, followed: bool = False) -> None:
    """Print a result unchanged; `followed`: exit code 0 when the pipe is closed."""
    with _printing():
        print(text, end="", flush=True)
    if followed and reader_has_left():
        raise SystemExit(0)


def reader_has_left() -> bool:
    return _reader_has_left


def say(text: str) -> None:
    if not quiet:
        err.print(folded(text), markup=False, soft_wrap=True)


def warn(*texts: str) -> None:
    for text in texts:
        line = escape(folded(text, after="Warning: "))
        err.print(f"[yellow]Warning:[/] {line}", soft_wrap=True)


@contextmanager
def progress(what: str, total: int, unit: Literal["bytes", "calls"]) -> Iterator[Advance]:
    if not is_live():
        yield lambda amount: None
        return

    done = rich_progress.DownloadColumn() if unit == "bytes" else rich_progress.MofNCompleteColumn()
    with rich_progress.Progress(
        rich_progress.TextColumn("{task.description}"), rich_progress.BarColumn(), done, console=err
    ) as bars:
        task = bars.add_task(escape(what), total=total)
        yield lambda amount: bars.advance(task, amount)


@contextmanager
def waiting(what: str, *, only_live: bool = False) -> Iterator[None]:
    """Show what the command is waiting for: a spinner on a terminal, else a line.

    With `only_live` there is no line, for scripts that read the first one.
    """
    if not is_live() and not only_live:
        say(what)
    with err.status(escape(what)) if is_live() else nullcontext():
        yield


def suggest(commands: list[tuple[str, str]], *, elsewhere: bool = False) -> None:
    """Print commands to paste next, each below its purpose, unless --quiet is given.

    zsh takes a comment after a command for arguments. Ours get this call's variables for folders
    and files, unless they are for a place `elsewhere`.
    """
    if quiet:
        return
    places = {} if elsewhere else activation.places(os.environ)
    err.print("Next:")
    for command, purpose in commands:
        line = escape(_repeated(command, places))
        err.print(f"  [dim]{escape(purpose)}:[/]\n    [bold]{line}[/]", soft_wrap=True)


def fail(message: str, remedy: str, code: int | None = None) -> None:
    """Print errors and remedies, in the same order.

    The last failure of a command has its exit `code`: with --json, its object is printed if the
    command had none.
    """
    if code is not None and as_json:
        emit_failure(message, remedy, code)
    pairs = [(message, remedy)]
    if "\n" in remedy:
        pairs = list(zip_longest(message.splitlines(), remedy.splitlines(), fillvalue=""))
    for sentence, what_to_do in pairs:
        line = escape(folded(sentence, after="Error: "))
        err.print(f"[bold red]Error:[/] {line}", soft_wrap=True)
        if what_to_do:
            line = escape(folded(what_to_do, after="  Try: "))
            err.print(f"  [dim]Try:[/] {line}", soft_wrap=True)


def folded(text: str, *, after: str = "") -> str:
    """For stderr: lines of whole words, the first `after` what stands there already.

    Addresses and commands stay in one piece, so that they can be copied.
    """
    if not err.file.isatty():
        return text
    whole = _COMMAND.sub(lambda found: found[0].replace(" ", _NO_BREAK), text)
    first, *others = f"{after}{whole}".split("\n")
    lines = [
        textwrap.fill(line, err.width, break_long_words=False, break_on_hyphens=False)
        for line in (first, *others)
    ]
    return "\n".join(lines)[len(after) :].replace(_NO_BREAK, " ")


def is_live() -> bool:
    """With FORCE_COLOR, Rich takes a pipe for a terminal."""
    attached = sys.stdin.isatty() and sys.stderr.isatty() and not quiet
    return attached and not err.is_dumb_terminal and not os.environ.get("NO_COLOR")


def _repeated(command: str, variables: Mapping[str, str]) -> str:
    words = shlex.split(command)
    own = [word.partition("=")[0] for word in takewhile(lambda word: "=" in word, words)]
    if not f"{words[len(own)]}-".startswith("dr-"):
        return command
    before = [f"{n}={shlex.quote(v)}" for n, v in variables.items() if n not in own]
    return " ".join([*before, command])


def _fitted(rendered: RenderableType, width: int) -> Segments:
    view = Text(rendered) if isinstance(rendered, str) else rendered
    lines = out.render_lines(view, out.options.update(max_width=width), pad=False)
    return Segments([segment for line in lines for segment in _trimmed(line)])


def _trimmed(line: list[Segment]) -> list[Segment]:
    while line and not line[-1].text.strip():
        line = line[:-1]
    if not line:
        return [Segment.line()]
    last = line[-1]
    return [*line[:-1], Segment(last.text.rstrip(), last.style), Segment.line()]


@contextmanager
def _printing() -> Iterator[None]:
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
    """Python would try to write it again at exit."""
    global _reader_has_left
    _reader_has_left = True
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())

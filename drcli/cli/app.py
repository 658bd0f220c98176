"""Builds the command line; the only place where failures become exit codes."""

import gc
import io
import os
import sys
import time
import traceback
from functools import cache
from pathlib import Path
from typing import Annotated

import typer

from drcli import __version__
from drcli.base import notices, verbosity
from drcli.base.errors import DrError
from drcli.cli import ascii_only
from drcli.cli.lazy import QUIET_HELP, LazyGroup
from drcli.cli.working_folder import working_folder

EPILOG = """Every command also has a name of its own: dr-status is dr status. `dr init` is the way
to begin, `dr completion install` lets the Tab key finish command lines.

\b
Exit codes:
    0  done
    1  answered with no, does not run, has no log yet, or a bug of ours
    2  wrong command line
    3  wrong setting, parameter file or reward function
    4  storage cannot be reached, read or written
    5  a worker died
    6  training cannot go on
    7  not built yet, or not installed here
    8  another machine has taken the model over
  130  interrupted (Ctrl-C)
  143  stopped (SIGTERM)
"""

GC_THRESHOLD = 50_000
"""New objects after which Python looks for garbage; its own 700 are reached at every import."""

app = typer.Typer(
    name="dr",
    cls=LazyGroup,
    help="Train, watch and race DeepRacer models on this machine.",
    epilog=EPILOG,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dr {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help=QUIET_HELP)] = False,
) -> None:
    """Options that belong to no command."""
    verbosity.quiet = quiet


def main(args: list[str] | None = None) -> None:
    """Run the command line, under whichever name it was called.

    Args:
        args: What follows `dr`; taken from the process if left out, where `dr-start-training` is
            `dr start-training`.

    Raises:
        SystemExit: Always, with the exit code.
    """
    # Loading modules makes many objects and no garbage; looking for some takes a tenth of the time.
    gc.set_threshold(GC_THRESHOLD)
    notices.show = _show_wait
    notices.warn = _show_warning
    _show_warning.cache_clear()
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            ascii_only.use(stream)  # a terminal that knows no braille gets no traceback
    try:
        app(_arguments(sys.argv) if args is None else args, prog_name="dr")
    except DrError as error:  # ours to explain; anything else is a bug
        from drcli.cli import console

        console.fail(str(error), error.remedy)
        raise SystemExit(error.code) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except Exception as error:
        if _is_interrupt(error):
            raise SystemExit(130) from None
        if os.environ.get("DR_DEBUG"):
            raise
        _report_bug(error)
        raise SystemExit(1) from None


def _show_wait(text: str) -> None:
    from drcli.cli import console

    console.say(text)


@cache
def _show_warning(text: str) -> None:
    """Once: whoever reads a damaged object again says so again."""
    from drcli.cli import console

    console.warn(text)


def _is_interrupt(error: BaseException) -> bool:
    """Whether Ctrl-C is behind a failure: libraries that are being loaded wrap it in their own."""
    return (
        isinstance(error, KeyboardInterrupt)
        or any(_is_interrupt(behind) for behind in (error.__cause__, error.__context__) if behind)
        or KeyboardInterrupt.__name__ in str(error)
    )


def _open_closed_streams() -> None:
    """Give a caller who closed a stream, as in `dr status <&-`, the one that is always there."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def _arguments(argv: list[str]) -> list[str]:
    """Arguments as `dr` would have got them."""
    name = Path(argv[0]).name.removesuffix(".exe")
    if name.startswith("droa-"):
        return [name, *argv[1:]]
    return [name.removeprefix("dr-"), *argv[1:]] if name.startswith("dr-") else argv[1:]


def _report_bug(error: Exception) -> None:
    """Keep the traceback for whoever mends it, and spare the user the sight."""
    from drcli.cli import console

    try:
        path = working_folder() / "data" / "logs" / f"crash-{time.strftime('%Y%m%d-%H%M%S')}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(traceback.format_exception(error)), "utf-8")
        remedy = f"Report it together with {path}."
    except (OSError, DrError):
        remedy = "Set DR_DEBUG=1 and run the command again to see where it comes from."
    console.fail(f"This is a bug of ours: {type(error).__name__}: {error}", remedy)

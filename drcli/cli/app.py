"""Runs the command line, and turns errors into exit codes."""

import codecs
import errno
import io
import os
import sys
import time
import traceback
from functools import cache
from pathlib import Path
from typing import NoReturn

from drcli.base import errors, installation
from drcli.base.errors import DrError, SettingsError, shown
from drcli.base.files import private
from drcli.base.processes import Interrupted, Stopped, search_rarely
from drcli.cli import completion, terminal
from drcli.cli.command_line import PROGRAM, application
from drcli.cli.working_folder import working_folder

# Replaces characters that a terminal lacks by similar ASCII ones.


HANDLER = "drcli.cli.app"
_BRAILLE = range(0x2800, 0x2900)
_MOST_DOTS = 8

_SIGNS = {
    **dict(zip("→↗↑↖←↙↓↘", ">/^\\</v\\", strict=True)),
    **dict(zip("▁▂▃▄▅▆▇█", "_.:-=+*#", strict=True)),
    **dict(zip("·◦●•…–—‘’“”×−✓✗", ".oO*.--''\"\"x-vx", strict=True)),
    **dict.fromkeys("─━╌═", "-"),
    **dict.fromkeys("│┃║", "|"),
    **dict.fromkeys("┌┐└┘├┤┬┴┼╭╮╰╯", "+"),
}


def use(stream: io.TextIOWrapper) -> None:
    codecs.register_error(HANDLER, _handle)
    stream.reconfigure(errors=HANDLER)


def plain(letter: str) -> str:
    if ord(letter) in _BRAILLE:
        dots = (ord(letter) - _BRAILLE.start).bit_count()
        return "#" if dots > _MOST_DOTS // 2 else "."
    return _SIGNS.get(letter, "?")


def _handle(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wanted = error.object[error.start : error.end]
    return "".join(map(plain, wanted)), error.end


_PERMISSIONS = "Correct its permissions, or choose another place."
_ROOM = "Free some disk space, and run the command again."
_FULL = (errno.ENOSPC, errno.EDQUOT)
"""Plain also without a name, which errors about an open file do not have."""

_NOT_OUR_BUGS = {
    errno.ENAMETOOLONG: "Choose a shorter name or path.",
    errno.ELOOP: "Correct the symbolic links on the way to it.",
    errno.ENOTDIR: "Choose another place: a part of this path is a file, not a folder.",
    errno.EACCES: _PERMISSIONS,
    errno.EPERM: _PERMISSIONS,
    errno.EROFS: _PERMISSIONS,
    errno.ENOSPC: _ROOM,
    errno.EDQUOT: _ROOM,
    errno.EIO: "Check the disk, or choose another place.",
}


def main(args: list[str] | None = None) -> None:
    """Run the command line.

    Raises:
        SystemExit: Always, with the exit code.
    """
    search_rarely()
    terminal.quiet = terminal.as_json = terminal.emitted = False
    errors.show = terminal.say
    errors.warn = cache(terminal.warn)  # once for each object
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            use(stream)  # a terminal that knows no braille gets no traceback
    arguments = _arguments(sys.argv) if args is None else args
    if completion.QUESTION in os.environ:
        arguments = _asked_about()
    with private(Path(os.environ.get("DR_DIR", "")) / "data"):
        _run(arguments)


def _run(arguments: list[str]) -> None:
    try:
        application(arguments)(arguments, prog_name=PROGRAM)
    except Stopped as error:  # somebody wanted it, so it is no error
        terminal.say(f"{error} {error.remedy}".strip())
        raise SystemExit(error.code) from None
    except DrError as error:  # ours to explain; anything else is a bug
        terminal.fail(str(error), error.remedy, error.code)
        raise SystemExit(error.code) from None
    except KeyboardInterrupt:
        _end_interrupted()
    except Exception as error:
        if _is_interrupt(error):
            _end_interrupted()
        if os.environ.get("DR_DEBUG"):
            raise
        if isinstance(error, OSError) and _is_not_ours(error):
            name = error.filename
            place = shown(os.fsdecode(name)) if name else "The disk of the working folder"
            number = error.errno or 0
            what = f"{place} cannot be used: {os.strerror(number)}."
            terminal.fail(what, _NOT_OUR_BUGS[number], SettingsError.code)
            raise SystemExit(SettingsError.code) from None
        if broken := installation.installation_error(error):
            terminal.fail(str(broken), broken.remedy, broken.code)
            raise SystemExit(broken.code) from None
        _report_bug(error)
        raise SystemExit(1) from None


def _is_not_ours(error: OSError) -> bool:
    return error.errno in _NOT_OUR_BUGS and bool(error.filename or error.errno in _FULL)


def _end_interrupted() -> NoReturn:
    terminal.say("Interrupted.")
    raise SystemExit(Interrupted.code) from None


def _is_interrupt(error: BaseException) -> bool:
    """Libraries that are being loaded wrap Ctrl-C in their own error."""
    return (
        isinstance(error, KeyboardInterrupt)
        or any(_is_interrupt(behind) for behind in (error.__cause__, error.__context__) if behind)
        or KeyboardInterrupt.__name__ in str(error)
    )


def _open_closed_streams() -> None:
    for name, mode in {"stdin": "r", "stdout": "w", "stderr": "w"}.items():
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def _arguments(argv: list[str]) -> list[str]:
    name = Path(argv[0]).name.removesuffix(".exe")
    if name.startswith("droa-"):
        return [name, *argv[1:]]
    return [name.removeprefix("dr-"), *argv[1:]] if name.startswith("dr-") else argv[1:]


def _asked_about() -> list[str]:
    program, _, rest = os.environ.get(completion.LINE, "").partition(" ")
    words = _arguments([program])
    os.environ[completion.LINE] = " ".join([PROGRAM, *words, rest])
    return [*words, *rest.split()]


def _report_bug(error: Exception) -> None:
    try:
        path = working_folder() / "data" / "logs" / f"crash-{time.strftime('%Y%m%d-%H%M%S')}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(traceback.format_exception(error)), "utf-8")
        remedy = f"Report it, and add {path}."
    except (OSError, DrError):
        remedy = "Set DR_DEBUG=1 and run the command again to see the traceback."
    terminal.fail(f"Internal error in drcli: {type(error).__name__}: {error}", remedy, 1)

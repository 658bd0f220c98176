"""Asks questions on stderr, with answers from stdin.

They wait for a minute: the terminal may be a cell of a notebook.
"""

import getpass
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from types import FrameType
from typing import TypeVar

from drcli.base.errors import Aborted, SettingsError
from drcli.cli import terminal

PATIENCE_S = 60.0
_PIPE_WAIT_S = 1.0
T = TypeVar("T")


def agree(
    question: str,
    *,
    yes: bool,
    remedy: str = "Add -f (or --yes) to answer yes.",
    words: Sequence[str] = (),
) -> None:
    """Ask before something is lost or replaced, unless an option says yes.

    Without a terminal, the answer comes from a pipe, as in `echo y | dr-...`, or is no.

    Raises:
        Aborted: The answer is no.
    """
    if yes:
        return
    if sys.stdin.isatty():
        asked = terminal.folded(f"{question} [y/N]")
        terminal.err.print(f"{asked} ", end="", markup=False, soft_wrap=True)
        answer = _within_patience(sys.stdin.readline, remedy)
    else:
        terminal.say(f"{question} [y/N]")
        answer = _line_in_pipe()
    if answer.strip().casefold() not in ("y", "yes") and answer.strip() not in words:
        raise Aborted("Aborting. Nothing was changed.", remedy=remedy)


def ask(question: str, default: str, choices: Sequence[str] = ()) -> str:
    """Ask on a terminal; Enter takes the default.

    Raises:
        Aborted: Nobody answers.
    """
    remedy = "Give the values as options, or add -f to take those in brackets without a question."
    offer = f" ({', '.join(choices)})" if choices else ""
    spelt = {choice.casefold(): choice for choice in choices}
    while True:
        terminal.err.print(f"{question}{offer} [{default}]: ", end="", markup=False, soft_wrap=True)
        line = _within_patience(sys.stdin.readline, remedy)
        answer = line.strip() or default
        if not choices or not line:
            return answer
        if answer.casefold() in spelt:
            return spelt[answer.casefold()]
        terminal.say(f"'{answer}' is not one of these.")


def secret(question: str, remedy: str) -> str:
    """Ask for a secret without showing it, or take it from a pipe.

    Raises:
        SettingsError: There is none.
        Aborted: Nobody answers.
    """
    if sys.stdin.isatty():
        with warnings.catch_warnings():
            warnings.simplefilter("error", getpass.GetPassWarning)
            try:
                answer = _within_patience(lambda: getpass.getpass(f"{question}: "), remedy)
            except (getpass.GetPassWarning, EOFError):
                answer = ""
    else:
        answer = _line_in_pipe().rstrip("\r\n")
    if not answer:
        raise SettingsError(f"No answer to the question: {question}.", remedy=remedy)
    return answer


def may_ask() -> bool:
    return sys.stdin.isatty() and sys.stderr.isatty()


class _TooLate(Exception):
    """Nobody has answered."""


def _within_patience(read: Callable[[], T], remedy: str) -> T:
    def give_up(_number: int, _frame: FrameType | None) -> None:
        raise _TooLate

    # A signal, because nothing else ends the reading of a password, or of half a line.
    handler = signal.signal(signal.SIGALRM, give_up)
    timer = signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    try:
        return read()
    except _TooLate:
        terminal.say("")  # the cursor is behind the question
        raise Aborted(
            "Nobody answered within a minute, which counts as no. Nothing was changed.",
            remedy=remedy,
        ) from None
    finally:
        signal.setitimer(signal.ITIMER_REAL, *timer)
        signal.signal(signal.SIGALRM, handler)


def _line_in_pipe() -> str:
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.append(sys.stdin.readline()), daemon=True)
    reader.start()
    reader.join(_PIPE_WAIT_S)
    return lines[0] if lines else ""

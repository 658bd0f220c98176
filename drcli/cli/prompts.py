"""Asks questions on stderr and reads the answers from stdin."""

import sys
import threading
from collections.abc import Sequence

from drcli.base.errors import Aborted, SettingsError
from drcli.cli import console

_PIPE_WAIT_S = 1.0
"""Longest time to wait for an answer in a pipe."""


def agree(
    question: str,
    *,
    yes: bool,
    remedy: str = "Add -f (or --yes) to answer yes.",
    words: Sequence[str] = (),
) -> None:
    """Ask before something is lost or replaced, unless an option has said yes already.

    Waits for an answer on a terminal only. Elsewhere it takes the answer from standard input, as
    in `echo y | dr-...`; without one, the answer is no. The remedy says how to avoid the question.
    `words` are other answers that mean yes.

    Raises:
        Aborted: The answer is no.
    """
    if yes:
        return
    if sys.stdin.isatty():
        console.err.print(f"{question} [y/N] ", end="", markup=False, soft_wrap=True)
        answer = sys.stdin.readline()
    else:
        console.say(f"{question} [y/N]")
        answer = _line_in_pipe()
    if answer.strip().casefold() not in ("y", "yes") and answer.strip() not in words:
        raise Aborted("Aborting. Nothing was changed.", remedy=remedy)


def ask(question: str, default: str, choices: Sequence[str] = ()) -> str:
    """Ask for one of these words, or for any; Enter takes the default. For terminals only."""
    offer = f" ({', '.join(choices)})" if choices else ""
    spelt = {choice.casefold(): choice for choice in choices}
    while True:
        console.err.print(f"{question}{offer} [{default}]: ", end="", markup=False, soft_wrap=True)
        line = sys.stdin.readline()
        answer = line.strip() or default
        if not choices or not line:
            return answer
        if answer.casefold() in spelt:
            return spelt[answer.casefold()]
        console.say(f"'{answer}' is not one of these.")


def secret(question: str, remedy: str) -> str:
    """Ask for a secret, which is not shown while it is typed.

    Without a terminal it is taken from standard input, as in `pass show droa | droa-...`.

    Raises:
        SettingsError: There is none. The remedy says how to give it.
    """
    if may_ask():
        import getpass
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("error", getpass.GetPassWarning)
            try:
                answer = getpass.getpass(f"{question}: ")
            except (getpass.GetPassWarning, EOFError):
                answer = ""
    else:
        answer = _line_in_pipe().rstrip("\r\n")
    if not answer:
        raise SettingsError(f"No answer to the question: {question}.", remedy=remedy)
    return answer


def may_ask() -> bool:
    """Whether the command runs on a terminal, where somebody can answer."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _line_in_pipe() -> str:
    """A line from standard input; empty when none comes, as from a pipe that stays silent."""
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.append(sys.stdin.readline()), daemon=True)
    reader.start()
    reader.join(_PIPE_WAIT_S)
    return lines[0] if lines else ""

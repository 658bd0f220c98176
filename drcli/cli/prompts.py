"""The one place that asks: questions go to stderr, answers come from stdin."""

import sys
import threading
from collections.abc import Sequence

from drcli.base.errors import Aborted
from drcli.cli import console

_ANSWER_PATIENCE_S = 1.0
"""Longest time to wait for an answer in a pipe."""


ASKS_NOTHING = "Add -f (or --yes) to answer yes."


def agree(question: str, *, yes: bool, remedy: str = ASKS_NOTHING) -> None:
    """Ask before something is lost or replaced, unless the user has said yes already.

    Waits for an answer on a terminal only. Elsewhere it takes the answer from standard input, as
    in `echo y | dr-...`; without one, the answer is no.

    Args:
        question: Ends with a question mark.
        yes: Whether the user said yes with a flag.
        remedy: How to avoid the question.

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
        answer = _waiting_line()
    if answer.strip().casefold() not in ("y", "yes"):
        raise Aborted("Aborting. Nothing was changed.", remedy=remedy)


def ask(question: str, default: str, choices: Sequence[str] = ()) -> str:
    """Ask for a word, on a terminal only; Enter takes the default.

    Args:
        question: The question, without a question mark.
        default: The answer when only Enter is pressed; may be empty.
        choices: The allowed words, in any letter case; any word when left out.
    """
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


def may_ask() -> bool:
    """Whether somebody is there to answer."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _waiting_line() -> str:
    """A line from standard input; empty when none comes, as from a pipe that stays silent."""
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.append(sys.stdin.readline()), daemon=True)
    reader.start()
    reader.join(_ANSWER_PATIENCE_S)
    return lines[0] if lines else ""

"""The one place that asks: questions go to stderr, answers come from stdin."""

import sys
import threading
from collections.abc import Sequence

from drcli.base.errors import Aborted
from drcli.cli import console

_ANSWER_PATIENCE_S = 1.0
"""For how long an answer may be on its way through a pipe."""


ASKS_NOTHING = "-f (or --yes) asks nothing."


def agree(question: str, *, yes: bool, remedy: str = ASKS_NOTHING) -> None:
    """Ask before something is lost or replaced, unless the user has said yes already.

    A question is put on a terminal only. Elsewhere an answer that already waits on standard input
    counts, as in `echo y | dr-...`; where none does, the answer is no.

    Args:
        question: Ends with a question mark.
        yes: The flag that asks nothing.
        remedy: How to be asked no more.

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
        question: What is wanted, without a question mark.
        default: What Enter means; empty where there is no such thing.
        choices: The words that are allowed, in any case; anything when left out.
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
        console.say(f"{answer} is none of these.")


def may_ask() -> bool:
    """Whether somebody is there to answer."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _waiting_line() -> str:
    """A line that waits on standard input; empty when none comes, as in an open, silent pipe."""
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.append(sys.stdin.readline()), daemon=True)
    reader.start()
    reader.join(_ANSWER_PATIENCE_S)
    return lines[0] if lines else ""

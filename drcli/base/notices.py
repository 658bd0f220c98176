"""Messages from below the command line: a command shows them, a worker logs them."""

from collections.abc import Callable

QUIET_S = 1.0
"""Shortest wait that is worth a message."""


def _ignore(_text: str) -> None:
    pass


show: Callable[[str], None] = _ignore
"""Says what the program waits for."""

warn: Callable[[str], None] = _ignore

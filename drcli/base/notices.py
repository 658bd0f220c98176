"""Messages from below the command line: a command shows them, a worker logs them."""

from collections.abc import Callable

QUIET_S = 1.0


def _ignore(_text: str) -> None:
    pass


show: Callable[[str], None] = _ignore
warn: Callable[[str], None] = _ignore

"""Messages of packages below the command line: commands show them, processes of a run log them."""

from collections.abc import Callable

QUIET_S = 1.0
"""Shortest wait that is worth a message, seconds."""


def _nobody(_text: str) -> None:
    """Show nothing: neither a command nor a process of a run."""


show: Callable[[str], None] = _nobody
"""Tells what is waited for."""

warn: Callable[[str], None] = _nobody
"""Tells a warning."""

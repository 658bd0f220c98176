"""Messages of packages below the command line, which shows them; workers show nothing."""

from collections.abc import Callable

QUIET_S = 1.0
"""Shortest wait that is worth a message, seconds."""


def _nobody(_text: str) -> None:
    """Show nothing, as in workers."""


show: Callable[[str], None] = _nobody
"""Shows one line; set by the command line."""

warn: Callable[[str], None] = _nobody
"""Shows a warning; set by the command line."""

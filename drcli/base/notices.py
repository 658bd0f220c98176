"""What is waited for, and what surprises: told by whoever meets it, shown by the command line.

Kept apart from the console, which takes longer to load. Workers show nothing.
"""

from collections.abc import Callable

QUIET_S = 1.0
"""Waits shorter than this are not worth a word, seconds."""


def _nobody(_text: str) -> None:
    """Workers have nobody to tell."""


show: Callable[[str], None] = _nobody
"""Shows one line; set by the command line."""

warn: Callable[[str], None] = _nobody
"""Shows a warning; set by the command line."""

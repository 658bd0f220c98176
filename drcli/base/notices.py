"""Words on long waits and on what surprises: the command line shows them, processes log them.

Apart from the console, which takes longer to load.
"""

from collections.abc import Callable

QUIET_S = 1.0
"""Waits shorter than this are not worth a word, seconds."""


def _nobody(_text: str) -> None:
    """Neither a command nor a process of a run."""


show: Callable[[str], None] = _nobody
"""Tells what is waited for."""

warn: Callable[[str], None] = _nobody
"""Tells a warning."""

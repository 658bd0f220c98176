"""Clocks that ignore the time of day."""

import time
from collections.abc import Callable

LONGEST_STEP_S = 5.0


def elapsed_s() -> float:
    """Counts also while suspended; equal for all processes."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


class AwakeClock:
    """Counts the seconds in which this process ran.

    If it was suspended, so may be those that it watches: a long time between two reads counts as
    `LONGEST_STEP_S`.
    """

    def __init__(self, clock: Callable[[], float] = elapsed_s) -> None:
        self._clock = clock
        self._read_s = clock()
        self._awake_s = 0.0

    def __call__(self) -> float:
        now_s = self._clock()
        self._awake_s += min(max(0.0, now_s - self._read_s), LONGEST_STEP_S)
        self._read_s = now_s
        return self._awake_s


def duration(seconds: float) -> str:
    """Such as "14 s", "12 min", "3 h 20 min"."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    if minutes < 120:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if minutes else f"{hours} h"

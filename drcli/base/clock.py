"""Clocks that ignore the time of day."""

import re
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from drcli.base import errors
from drcli.base.errors import SettingsError

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


# Times as people write them on a command line.


_SPAN = re.compile(r"(\d{1,6})\s*([mhdw])")
_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}


def date_or_span(text: str, now: datetime, direction: int) -> datetime:
    """A UTC date, or one so long after (1) or before (-1) now.

    Raises:
        ValueError: It is neither.
        OverflowError: It is too far away.
    """
    span = _SPAN.fullmatch(text.strip().casefold())
    if span is not None:
        return now + direction * timedelta(**{_UNITS[span[2]]: int(span[1])})
    read = datetime.fromisoformat(text.strip())
    return read.replace(tzinfo=UTC) if read.tzinfo is None else read.astimezone(UTC)


def moment(option: str, text: str, now: datetime) -> datetime:
    """A UTC date such as 2026-11-20T08:30, or an age: 30m, 12h, 7d, 3w.

    Raises:
        SettingsError: It is neither.
    """
    try:
        return date_or_span(text, now, -1)
    except (ValueError, OverflowError):
        raise SettingsError(
            f"{option} {text} is neither a date nor an age.",
            remedy="Write a date such as 2026-11-20, or an age such as 30m, 12h, 7d or 3w.",
        ) from None


Waiting = Callable[[str], AbstractContextManager[None]]
"""Shows what takes a while, as long as it does."""

# Waiting for a condition, with growing pauses.


FIRST_DELAY_S = 0.05
LAST_DELAY_S = 1.0

FAST_GROWTH = 2.0
SLOW_GROWTH = 1.05
"""A twentieth of the time waited."""


def delays_s(
    first_s: float = FIRST_DELAY_S, last_s: float = LAST_DELAY_S, *, growth: float = FAST_GROWTH
) -> Iterator[float]:
    delay_s = first_s
    while True:
        yield delay_s
        delay_s = min(growth * delay_s, last_s)


def wait_until(
    condition: Callable[[], bool],
    *,
    patience_s: float,
    first_s: float = FIRST_DELAY_S,
    last_s: float = LAST_DELAY_S,
    what: str = "",
    clock: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
) -> bool:
    """Whether the condition holds within `patience_s`; `what` is shown if that takes long.

    Tests replace `clock` and `pause`.
    """
    began_s = clock()
    for delay_s in delays_s(first_s, last_s):
        if condition():
            return True
        waited_s = clock() - began_s
        left_s = patience_s - waited_s
        if what and waited_s > errors.QUIET_S:
            errors.show(what)
            what = ""
        if left_s <= 0:
            return False
        pause(min(delay_s, left_s))
    raise AssertionError("delays_s never ends")


# Tells steady growth from ups and downs.


MOST_SAMPLES = 720
PARTS = 6
"""The lowest value must rise from part to part. Noise does that in one of 720 times."""

LEAST_SAMPLES = 3 * PARTS


@dataclass(frozen=True)
class Growth:
    """Steady."""

    begin: float
    end: float
    seconds: float

    @property
    def per_s(self) -> float:
        return (self.end - self.begin) / self.seconds


class Trend:
    """In bounded memory."""

    def __init__(self, least_s: float = 120.0) -> None:
        self._least_s = least_s
        self._samples: deque[tuple[float, float]] = deque()
        self._every_s = 0.0

    def add(self, now_s: float, value: float) -> None:
        samples = self._samples
        if samples and now_s - samples[-1][0] < self._every_s:
            return
        samples.append((now_s, value))
        if len(samples) > MOST_SAMPLES:
            self._every_s = 2.0 * (now_s - samples[0][0]) / len(samples)
            self._samples = deque(list(samples)[::2])

    @property
    def seconds(self) -> float:
        return self._samples[-1][0] - self._samples[0][0] if self._samples else 0.0

    def growth(self, least: float, share: float = 0.0) -> Growth | None:
        """The steady growth that goes on now, or None.

        Looks at the last half of the time, then the last quarter, and so on.
        """
        span_s = self.seconds / 2.0
        while span_s >= self._least_s:
            found = self._growth_in(span_s)
            if found is not None and found.end - found.begin >= max(least, share * found.begin):
                return found
            span_s /= 2.0
        return None

    def _growth_in(self, span_s: float) -> Growth | None:
        end_s = self._samples[-1][0]
        begin_s = end_s - span_s
        recent = [(at_s, value) for at_s, value in self._samples if at_s >= begin_s]
        if len(recent) < LEAST_SAMPLES:
            return None
        lows: list[tuple[float, float] | None] = [None] * PARTS
        for at_s, value in recent:
            part = min(PARTS - 1, int(PARTS * (at_s - begin_s) / span_s))
            low = lows[part]
            if low is None or value < low[1]:
                lows[part] = at_s, value
        found = [low for low in lows if low is not None]
        rises = all(after[1] > before[1] for before, after in pairwise(found))
        if len(found) < PARTS or not rises:
            return None
        (first_s, first), (last_s, last) = found[0], found[-1]
        return Growth(first, last, last_s - first_s)

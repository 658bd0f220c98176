"""Tells steady growth from ups and downs."""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

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

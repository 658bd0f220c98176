"""What a sample of laps says about a checkpoint: how many are clean, and how fast they are.

A *clean lap* is completed without a reset and without a penalty. Evaluations during a training end
an episode at the first violation, so each completed lap of them is clean. A *finished lap* is
completed too, but the car may have been put back on the track, which the reference counts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

Z_95 = 1.959964
"""Standard score of a two-sided interval of 95 %."""

CONFIRMING_LAPS = 40
"""Laps from starts not driven before that decide whether a checkpoint is as good as it seems."""

CONFIRMING_CLEAN = 38
"""How many of these must be clean to reach a goal."""


@dataclass(frozen=True)
class Laps:
    """A sample of laps of one checkpoint.

    Attributes:
        driven: Number of laps, clean or not.
        clean_s: Times of the clean ones, simulated seconds.
    """

    driven: int
    clean_s: Sequence[float]

    @property
    def clean(self) -> int:
        """Number of clean laps."""
        return len(self.clean_s)

    @property
    def median_s(self) -> float | None:
        """Median time of the clean laps; None without one."""
        return median(self.clean_s) if self.clean_s else None

    @property
    def p90_s(self) -> float | None:
        """The time that nine of ten clean laps do not exceed; None without a clean lap."""
        return sorted(self.clean_s)[math.ceil(0.9 * self.clean) - 1] if self.clean_s else None

    @property
    def fastest_s(self) -> float | None:
        """Time of the fastest clean lap; None without one."""
        return min(self.clean_s, default=None)

    @property
    def slowest_s(self) -> float | None:
        """Time of the slowest clean lap; None without one."""
        return max(self.clean_s, default=None)

    @property
    def interval(self) -> tuple[float, float]:
        """Between which shares of clean laps the true one is, with a confidence of 95 %."""
        return share_interval(self.clean, self.driven)

    def within(self, most_s: float | None) -> "Laps":
        """The same sample if a lap slower than `most_s` does not count as clean."""
        if most_s is None:
            return self
        return Laps(self.driven, [lap_s for lap_s in self.clean_s if lap_s <= most_s])

    def __add__(self, other: "Laps") -> "Laps":
        return Laps(self.driven + other.driven, [*self.clean_s, *other.clean_s])

    def __str__(self) -> str:
        """Such as "39 of 40 laps clean, median 7.61 s, slowest 7.93 s"."""
        words = f"{self.clean} of {self.driven} {'lap' if self.driven == 1 else 'laps'} clean"
        if self.clean == 1:
            return f"{words}, {self.clean_s[0]:.2f} s"
        if self.clean:
            words += f", median {self.median_s:.2f} s, slowest {self.slowest_s:.2f} s"
        return words


def share_interval(count: int, of: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's score interval of a share, within [0, 1].

    Unlike the usual interval, it is right for few trials and for shares next to 0 and 1.

    Args:
        count: Successes.
        of: Trials, at least one.
        z: Standard score of the confidence.
    """
    share, square = count / of, z * z / of
    middle = share + square / 2.0
    half = math.sqrt(square * (share * (1.0 - share) + square / 4.0))
    low, high = (middle - half) / (1.0 + square), (middle + half) / (1.0 + square)
    # At the ends, the formula gives them exactly but for rounding.
    return 0.0 if count == 0 else low, 1.0 if count == of else high

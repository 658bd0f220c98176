"""What a sample of laps says about a checkpoint.

A *clean lap* is completed without violation, reset or penalty, as is each completed lap of an
evaluation during training. A *finished lap* is completed, maybe with resets.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median

Z_95 = 1.959964
CONFIRMING_LAPS = 40
"""From new starts: is a checkpoint as good as it seems?"""

CONFIRMING_CLEAN = 38


@dataclass(frozen=True)
class Laps:
    """Laps of one checkpoint; `clean_s` are simulated seconds."""

    driven: int
    clean_s: Sequence[float]

    @property
    def clean(self) -> int:
        return len(self.clean_s)

    @property
    def median_s(self) -> float | None:
        return median(self.clean_s) if self.clean_s else None

    @property
    def p90_s(self) -> float | None:
        """Nine of ten clean laps do not exceed it."""
        return sorted(self.clean_s)[math.ceil(0.9 * self.clean) - 1] if self.clean_s else None

    @property
    def fastest_s(self) -> float | None:
        return min(self.clean_s, default=None)

    @property
    def slowest_s(self) -> float | None:
        return max(self.clean_s, default=None)

    @property
    def interval(self) -> tuple[float, float]:
        """Of the true share of clean laps, 95 % confidence."""
        return share_interval(self.clean, self.driven)

    def within(self, most_s: float | None) -> "Laps":
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


def is_clean_lap(finished: bool, *faults: float | None) -> bool:
    """Finished without `faults`: violations, resets, penalty (None: not recorded)."""
    return finished and not any(faults)


def laps_summary(laps: Laps, *, resets: int, finished: int, best: str) -> str:
    """Such as "2 of 3 laps clean (1 reset), 3 finished, best 7.73 s"."""
    words = f"{laps.clean} of {laps.driven} {'lap' if laps.driven == 1 else 'laps'} clean"
    if resets:
        words += f" ({counted_resets(resets)})"
    if finished > laps.clean:
        words += f", {finished} finished"
    if best:
        words += f", {'best' if laps.clean else 'the fastest in'} {best}"
    return words


def lap_time(
    lap_s: float,
    penalty_s: float | None,
    resets: int,
    clock: Callable[[float], str] | None = None,
) -> str:
    """Such as "7.80 s", or "12.80 s = 7.80 driven + 5.00 penalty, 1 reset".

    `lap_s` includes penalties.
    """
    words = f"{lap_s:.2f} s" if clock is None else clock(lap_s)
    if penalty_s:
        driven_s = lap_s - penalty_s
        driven = f"{driven_s:.2f}" if clock is None else clock(driven_s)
        words += f" = {driven} driven + {penalty_s:.2f} penalty"
    return f"{words}, {counted_resets(resets)}" if resets else words


def counted_resets(count: int) -> str:
    return f"{count} reset{'s' * (count != 1)}"


def paired_p(differences: Iterable[int]) -> float:
    """Probability of so large a sum of differences, or larger, if each sign were a coin flip.

    The exact two-sided permutation test for pairs of whole numbers; for -1, 0 and 1, McNemar's.
    """
    import numpy as np  # here, to keep commands fast

    flipped = [difference for difference in differences if difference]
    sizes = sorted(map(abs, flipped))
    chances = np.zeros(sum(sizes) + 1)  # of each sum of those that are positive
    chances[0], most = 1.0, 0
    for size in sizes:
        most += size
        chances[: most + 1] /= 2.0
        chances[size : most + 1] += chances[: most + 1 - size].copy()
    # A sum of all is as small as this one if at most so much of it is positive.
    fewest = (most - abs(sum(flipped))) // 2
    return min(1.0, 2.0 * float(chances[: fewest + 1].sum()))


def share_interval(count: int, of: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's score interval of a share, within [0, 1].

    Unlike the usual one, right for few trials and shares near 0 and 1.
    """
    share, square = count / of, z * z / of
    middle = share + square / 2.0
    half = math.sqrt(square * (share * (1.0 - share) + square / 4.0))
    low, high = (middle - half) / (1.0 + square), (middle + half) / (1.0 + square)
    # At the ends, the formula gives them exactly but for rounding.
    return 0.0 if count == 0 else low, 1.0 if count == of else high

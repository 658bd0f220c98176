"""What a sample of laps says about a checkpoint: how many are clean, and how fast they are.

A *clean lap* is completed without a violation, a reset and a penalty. Evaluations during a training
end an episode at the first violation, so each completed lap of them is clean. A *finished lap* is
completed too, but the car may have been put back on the track, which the reference counts.
"""

import math
from collections.abc import Callable, Iterable, Sequence
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


def is_clean_lap(finished: bool, *faults: float | None) -> bool:
    """Whether a lap is clean: it is finished, and none of these happened to it.

    Args:
        finished: Whether it was completed.
        faults: Counts of violations and resets, and its penalty; None for what nobody recorded.
    """
    return finished and not any(faults)


def laps_summary(laps: Laps, *, resets: int, finished: int, best: str) -> str:
    """Such as "2 of 3 laps clean (1 reset), 3 finished, best 7.73 s".

    Args:
        laps: The sample.
        resets: How often the car was put back in all of its laps.
        finished: How many of them were completed, clean or not.
        best: Time of the fastest clean lap; without one, that of the fastest finished lap with its
            resets, as `lap_time` tells it; empty without either.
    """
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

    Args:
        lap_s: Simulated seconds, penalties included.
        penalty_s: The penalties among them; None if nobody recorded them.
        resets: How often the car was put back on the track.
        clock: Writes times otherwise than in seconds, such as "0:12.800".
    """
    words = f"{lap_s:.2f} s" if clock is None else clock(lap_s)
    if penalty_s:
        driven_s = lap_s - penalty_s
        driven = f"{driven_s:.2f}" if clock is None else clock(driven_s)
        words += f" = {driven} driven + {penalty_s:.2f} penalty"
    return f"{words}, {counted_resets(resets)}" if resets else words


def counted_resets(count: int) -> str:
    """Such as "1 reset"."""
    return f"{count} reset{'s' * (count != 1)}"


def paired_p(differences: Iterable[int]) -> float:
    """Probability of so large a sum of differences, or a larger one, if each sign were a coin flip.

    This is the exact permutation test for pairs, two-sided. For differences of -1, 0 and 1 it is
    McNemar's exact test.

    Args:
        differences: One for each pair, in units that make them whole numbers.
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

"""How sure a difference of two trainings is: bootstrap over iterations and their episodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drcli.analysis.spans import Numbers

RESAMPLES = 2000

SURE = 0.95
"""Share of the resamples that the interval of a difference covers."""

LEAST_GROUPS = 3
"""Fewer iterations on a side say nothing about chance."""


@dataclass(frozen=True)
class Difference:
    """A difference of a second training from a first.

    Attributes:
        difference: Second less first.
        low: Least difference that chance leaves plausible, with SURE.
        high: Greatest such difference.
        beyond_chance: Whether both have the same sign.
    """

    difference: float
    low: float
    high: float

    @property
    def beyond_chance(self) -> bool:
        """Whether the difference is larger than the noise of the trainings."""
        return self.low > 0.0 or self.high < 0.0


def compare_means(
    first: Sequence[Numbers], second: Sequence[Numbers], *, seed: int = 0
) -> Difference | None:
    """The difference of a mean over episodes, with its uncertainty.

    Episodes of one iteration were driven by the same weights, so they are alike, and treating all
    as independent would call chance a difference. Therefore iterations are drawn first, then
    episodes within each.

    Args:
        first: The values of each iteration of the first training, one for each episode.
        second: The same of the second.
        seed: Of the random numbers, so that the answer is always the same.

    Returns:
        The difference; None where a side has too few iterations with values.
    """
    sides = [[group for group in side if len(group)] for side in (first, second)]
    if min(map(len, sides)) < LEAST_GROUPS:
        return None
    random = np.random.default_rng(seed)
    found = [float(np.concatenate(side).mean()) for side in sides]
    before, after = (_drawn_means(random, side) for side in sides)
    low, high = np.percentile(after - before, [50.0 * (1.0 - SURE), 50.0 * (1.0 + SURE)])
    return Difference(found[1] - found[0], float(low), float(high))


def _drawn_means(random: np.random.Generator, groups: Sequence[Numbers]) -> Numbers:
    """The mean of each resample. Shape (RESAMPLES,)."""
    sizes = np.array([len(group) for group in groups])
    table = np.zeros((len(groups), sizes.max()))
    for row, group in zip(table, groups, strict=True):
        row[: len(group)] = group
    chosen = random.integers(len(groups), size=(RESAMPLES, len(groups)))
    sums = np.zeros(RESAMPLES)
    for at in range(len(groups)):
        group = chosen[:, at]
        places = random.integers(sizes[group][:, None], size=(RESAMPLES, int(sizes.max())))
        counted = np.arange(sizes.max()) < sizes[group][:, None]
        sums += (table[group[:, None], places] * counted).sum(axis=1)
    return np.asarray(sums / sizes[chosen].sum(axis=1))

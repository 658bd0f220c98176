"""Uncertainty of a difference of two trainings, by bootstrap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drcli.analysis.spans import Numbers

RESAMPLES = 2000

SURE = 0.95
LEAST_GROUPS = 3


@dataclass(frozen=True)
class Difference:
    """Second training less first, with the interval that chance leaves plausible."""

    difference: float
    low: float
    high: float

    @property
    def beyond_chance(self) -> bool:
        return self.low > 0.0 or self.high < 0.0


def compare_means(
    first: Sequence[Numbers], second: Sequence[Numbers], *, seed: int = 0
) -> Difference | None:
    """The difference of a mean over episodes; None where a side has too few iterations with values.

    Each array has the episodes of an iteration. They were driven by the same weights and are
    alike, so iterations are drawn first, then episodes within each.
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

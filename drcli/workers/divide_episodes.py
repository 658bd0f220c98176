"""Divides the episodes of an iteration by the speeds of workers."""

from collections.abc import Sequence
from statistics import median

EQUAL_WITHIN = 1.5
"""Within this factor shares are equal: how long episodes last differs too, and equal shares let a
training be repeated exactly.
"""


def divide(episodes: int, speeds: Sequence[float | None], most: int) -> list[int]:
    """Counts with the sum `episodes`; 0 for less than half an episode.

    `speeds`: None for a worker that has not driven yet, which counts as the median. `most` is
    raised where it is too few.
    """
    if not speeds:
        return []
    most = max(most, -(-episodes // len(speeds)))
    known = [speed for speed in speeds if speed]
    usual = median(known) if known else 1.0
    weights = [speed or usual for speed in speeds]
    if max(weights) <= EQUAL_WITHIN * min(weights):
        weights = [1.0] * len(weights)
    counts = [0] * len(weights)
    left = episodes
    while left:
        # Those that are full drop out, and the others share what is left.
        open_ones = [at for at, count in enumerate(counts) if count < most]
        total = sum(weights[at] for at in open_ones)
        quotas = {at: left * weights[at] / total for at in open_ones}
        whole = {at: min(int(quotas[at]), most - counts[at]) for at in open_ones}
        for at, count in whole.items():
            counts[at] += count
        if not any(whole.values()):
            # By the largest fraction; of equal ones, the first.
            by_fraction = sorted(open_ones, key=lambda at: (-quotas[at], at))
            for at in by_fraction[:left]:
                counts[at] += 1
        left = episodes - sum(counts)
    return counts

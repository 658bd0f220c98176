"""Divides the episodes of an iteration between workers that are not equally fast."""

from collections.abc import Sequence
from statistics import median

EQUAL_WITHIN = 1.5
"""Workers whose speeds differ by less than this factor get equal shares: how long episodes last
differs from worker to worker too, and equal shares let a training be repeated exactly."""


def divide(episodes: int, speeds: Sequence[float | None], most: int) -> list[int]:
    """How many episodes each worker drives.

    Args:
        episodes: Of the iteration.
        speeds: Steps per second of each worker; None for one that has not driven yet, which is
            taken to be as fast as the one in the middle.
        most: Episodes that one worker may drive. It is raised where that would be too few.

    Returns:
        As many counts as speeds, with the sum `episodes`. A worker that is too slow for half an
        episode gets none.
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

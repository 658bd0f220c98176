"""How the workers of a run share the processor of this machine."""

import os

from drcli.config import Settings

OVERLAP_CORES = 4
"""From so many cores on, driving and learning go on at the same time."""


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def overlaps(settings: Settings) -> bool:
    """Whether the next iteration is driven while the last one is learned from."""
    if settings.train_overlap == "auto":
        return cores() >= OVERLAP_CORES
    return settings.train_overlap == "on"


def driving_threads(settings: Settings) -> int:
    """Threads of one simulation worker: all share the cores that learning leaves."""
    mine = cores() - learning_threads(settings) if overlaps(settings) else cores()
    return max(1, mine // settings.workers)


def learning_threads(settings: Settings) -> int:
    """Threads of the trainer: all cores where it has them to itself, else half."""
    return max(1, cores() // 2) if overlaps(settings) else cores()

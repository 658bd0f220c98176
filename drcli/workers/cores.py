"""Divides the processor cores of this machine between the workers of a run."""

import math
from collections.abc import Iterator
from pathlib import Path

from drcli.base.memory import ROOT, group_folders
from drcli.base.system_calls import cores_of_process
from drcli.config.run_config import TrainConfig

OVERLAP_CORES = 4
"""From here on, driving and learning run at the same time."""


def cores(root: Path = ROOT) -> int:
    """By `taskset`, or the limit of a container, rounded up."""
    return max(1, min([cores_of_process(), *(math.ceil(limit) for limit in _limits(root))]))


def usable_cores(train: TrainConfig) -> int:
    found = cores()
    return min(found, train.threads or found)


def overlaps(train: TrainConfig) -> bool:
    """Whether the next iteration is driven while the last one is learned from."""
    if train.train_overlap == "auto":
        return train.train_max_lag > 1 or usable_cores(train) >= OVERLAP_CORES
    return train.train_overlap == "on"


def max_lag(train: TrainConfig) -> int:
    """How many iterations driving may be ahead; 0 to take turns."""
    return train.train_max_lag if overlaps(train) else 0


def with_known_overlap(train: TrainConfig) -> TrainConfig:
    """For machines whose cores do not decide whether work overlaps."""
    return train.replaced(train_overlap="on" if overlaps(train) else "off")


def driving_threads(train: TrainConfig) -> int:
    """Of one worker; workers share the cores that the trainer leaves.

    One that joins from another machine uses all of its own: `usable_cores`.
    """
    mine = usable_cores(train)
    if overlaps(train):
        mine -= learning_threads(train)
    return max(1, mine // train.workers)


def learning_threads(train: TrainConfig) -> int:
    """Half of the cores if driving and learning overlap, else all."""
    if train.workers == 0:
        return usable_cores(train)
    return max(1, usable_cores(train) // 2) if overlaps(train) else usable_cores(train)


def _limits(root: Path) -> Iterator[float]:
    for folder, unified in group_folders("cpu", root):
        names = ("cpu.max",) if unified else ("cpu.cfs_quota_us", "cpu.cfs_period_us")
        limit = _limit(*(folder / name for name in names))
        if limit is not None:
            yield limit


def _limit(*files: Path) -> float | None:
    """Quota divided by period. No limit is "max", or -1 in version 1."""
    try:
        words = " ".join(file.read_text("ascii", "replace") for file in files).split()
        quota_us, period_us = (int(word) for word in words)
    except (OSError, ValueError):
        return None
    return quota_us / period_us if quota_us > 0 and period_us > 0 else None

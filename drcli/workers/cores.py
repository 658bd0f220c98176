"""Divides the processor cores of this machine between the workers of a run."""

import math
from collections.abc import Iterator
from pathlib import Path

from drcli.base.control_groups import ROOT, group_folders
from drcli.base.system_calls import cores_of_process
from drcli.config.run_config import TrainConfig

OVERLAP_CORES = 4
"""With this many cores or more, driving and learning run at the same time."""


def cores(root: Path = ROOT) -> int:
    """Processor cores that this process may use.

    These are the cores that it may run on (`taskset`), or fewer if a container or service limits
    them (`docker run --cpus`). Such a limit is rounded up.
    """
    return max(1, min([cores_of_process(), *(math.ceil(limit) for limit in _limits(root))]))


def usable_cores(train: TrainConfig) -> int:
    """Processor cores that a run may use: those of this process, at most DR_THREADS."""
    found = cores()
    return min(found, train.threads or found)


def overlaps(train: TrainConfig) -> bool:
    """Whether the next iteration is driven while the last one is learned from."""
    if train.train_overlap == "auto":
        return train.train_max_lag > 1 or usable_cores(train) >= OVERLAP_CORES
    return train.train_overlap == "on"


def max_lag(train: TrainConfig) -> int:
    """By how many iterations driving may be ahead of learning; 0 if the two take turns."""
    return train.train_max_lag if overlaps(train) else 0


def with_known_overlap(train: TrainConfig) -> TrainConfig:
    """The same for processes on other machines, whose cores do not decide whether work overlaps."""
    return train.replaced(train_overlap="on" if overlaps(train) else "off")


def driving_threads(train: TrainConfig) -> int:
    """Threads of one simulation worker; the workers share the cores that the trainer leaves.

    One that joins a training from another machine uses all cores of its own: `usable_cores`.
    """
    mine = usable_cores(train)
    if overlaps(train):
        mine -= learning_threads(train)
    return max(1, mine // train.workers)


def learning_threads(train: TrainConfig) -> int:
    """Threads of the trainer: half of the cores if driving and learning overlap, else all.

    Without workers on its machine, it has all cores.
    """
    if train.workers == 0:
        return usable_cores(train)
    return max(1, usable_cores(train) // 2) if overlaps(train) else usable_cores(train)


def _limits(root: Path) -> Iterator[float]:
    """The limits of this process's control groups, in cores."""
    for folder, unified in group_folders("cpu", root):
        names = ("cpu.max",) if unified else ("cpu.cfs_quota_us", "cpu.cfs_period_us")
        limit = _limit(*(folder / name for name in names))
        if limit is not None:
            yield limit


def _limit(*files: Path) -> float | None:
    """Quota divided by period, from the files that have them; None without a limit.

    Without a limit, the quota is "max", or -1 in the first version of control groups.
    """
    try:
        words = " ".join(file.read_text("ascii", "replace") for file in files).split()
        quota_us, period_us = (int(word) for word in words)
    except (OSError, ValueError):
        return None
    return quota_us / period_us if quota_us > 0 and period_us > 0 else None

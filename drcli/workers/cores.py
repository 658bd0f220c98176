"""How the workers of a run share the processor of this machine."""

import math
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from drcli.config.settings import TrainConfig

OVERLAP_CORES = 4
"""With this many cores or more, driving and learning run at the same time."""

_ROOT = Path("/")


def cores(root: Path = _ROOT) -> int:
    """Processor cores that this process may use.

    Those that it may run on (`taskset`), or fewer if a container or service has a limit
    (`docker run --cpus`), which is rounded up.
    """
    if hasattr(os, "sched_getaffinity"):
        allowed = len(os.sched_getaffinity(0))
    else:
        allowed = os.cpu_count() or 1
    return max(1, min([allowed, *(math.ceil(limit) for limit in _limits(root))]))


def overlaps(train: TrainConfig) -> bool:
    """Whether the next iteration is driven while the last one is learned from."""
    if train.train_overlap == "auto":
        return cores() >= OVERLAP_CORES
    return train.train_overlap == "on"


def driving_threads(train: TrainConfig) -> int:
    """Threads of one simulation worker; the workers share the cores that the trainer leaves."""
    mine = cores() - learning_threads(train) if overlaps(train) else cores()
    return max(1, mine // train.workers)


def learning_threads(train: TrainConfig) -> int:
    """Threads of the trainer: half of the cores if driving and learning overlap, else all."""
    return max(1, cores() // 2) if overlaps(train) else cores()


def _limits(root: Path) -> Iterator[float]:
    """The limits of this process's control groups, in cores; groups without one are skipped."""
    try:
        lines = (root / "proc/self/cgroup").read_text("utf-8", "replace").splitlines()
    except OSError:  # another system than Linux
        return
    for line in lines:
        if line.count(":") < 2:
            continue
        _, controllers, path = line.split(":", 2)
        unified = controllers == ""
        if not unified and "cpu" not in controllers.split(","):
            continue
        mount = root / "sys/fs/cgroup" / controllers
        group = PurePosixPath(path.lstrip("/"))
        # A container sees the path that its group has outside, and its own group at the root.
        for folder in (mount / group, *(mount / parent for parent in group.parents)):
            limit = _unified_limit(folder) if unified else _older_limit(folder)
            if limit is not None:
                yield limit


def _unified_limit(folder: Path) -> float | None:
    """The limit in `cpu.max`: `150000 100000`, or `max 100000` for none."""
    words = _words(folder / "cpu.max")
    return None if len(words) != 2 else _share(*words)


def _older_limit(folder: Path) -> float | None:
    """The limit of version 1 of control groups, whose quota is -1 for none."""
    words = [
        *_words(folder / "cpu.cfs_quota_us"),
        *_words(folder / "cpu.cfs_period_us"),
    ]
    return None if len(words) != 2 else _share(*words)


def _share(quota: str, period: str) -> float | None:
    try:
        used_us, of_us = int(quota), int(period)
    except ValueError:  # "max"
        return None
    return used_us / of_us if used_us > 0 and of_us > 0 else None


def _words(file: Path) -> list[str]:
    try:
        return file.read_text("ascii", "replace").split()
    except OSError:
        return []

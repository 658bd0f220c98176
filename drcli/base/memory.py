"""How much memory this process may still use."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import psutil

# Finds this process's control groups, where Linux keeps limits of containers.


ROOT = Path("/")


def group_folders(controller: str, root: Path = ROOT) -> Iterator[tuple[Path, bool]]:
    """The innermost first, and whether they are of the second version."""
    try:
        lines = (root / "proc/self/cgroup").read_text("utf-8", "replace").splitlines()
    except OSError:  # another system than Linux
        return
    for line in lines:
        if line.count(":") < 2:
            continue
        _, controllers, path = line.split(":", 2)
        unified = controllers == ""
        if not unified and controller not in controllers.split(","):
            continue
        mount = root / "sys/fs/cgroup" / controllers
        group = PurePosixPath(path.lstrip("/"))
        # A container sees the path that its group has outside, and its own group at the root.
        for folder in (mount / group, *(mount / parent for parent in group.parents)):
            yield folder, unified


_UNLIMITED = 1 << 60
"""Control groups write a number near 2**63."""

_FIRST_VERSION = ("memory.limit_in_bytes", "memory.usage_in_bytes")


@dataclass(frozen=True)
class MemoryState:
    """Memory at one moment.

    Attributes:
        available_bytes: Free, or can be freed at once.
        limited: By a control group.
        kills: Processes killed for lack of memory.
    """

    total_bytes: int
    available_bytes: int
    limited: bool = False
    kills: int = 0

    @property
    def place(self) -> str:
        gigabytes = f"{self.total_bytes / 1e9:.1f} GB"
        return (
            f"the memory limit of the container or control group ({gigabytes})"
            if self.limited
            else f"the memory of the machine ({gigabytes})"
        )


def read_memory(root: Path = ROOT) -> MemoryState:
    machine, swap = psutil.virtual_memory(), psutil.swap_memory()
    found = MemoryState(machine.total + swap.total, machine.available + swap.free)
    for limit, used in group_limits(root):
        if used is None:
            continue
        available = max(0, limit - used)
        if limit < found.total_bytes and available < found.available_bytes:
            found = MemoryState(limit, available, limited=True)
    return MemoryState(found.total_bytes, found.available_bytes, found.limited, _kills(root))


def group_limits(root: Path = ROOT) -> Iterator[tuple[int, int | None]]:
    for folder, unified in group_folders("memory", root):
        names = ("memory.max", "memory.current") if unified else _FIRST_VERSION
        limit, used = (_number(folder / name) for name in names)
        if limit is None or limit >= _UNLIMITED:
            continue
        # Pages of files that nobody has used for a while are given back before anybody is killed.
        stat = _counts(folder / "memory.stat")
        cache = stat.get("inactive_file" if unified else "total_inactive_file", 0)
        yield limit, None if used is None else max(0, used - cache)


def _kills(root: Path) -> int:
    for folder, unified in group_folders("memory", root):
        counts = _counts(folder / ("memory.events" if unified else "memory.oom_control"))
        if "oom_kill" in counts:
            # The count of the machine contains those of all groups.
            machine = _counts(root / "proc/vmstat").get("oom_kill", 0)
            return max(machine, counts["oom_kill"])
    return _counts(root / "proc/vmstat").get("oom_kill", 0)


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text("ascii", "replace"))
    except (OSError, ValueError):
        return None


def _counts(path: Path) -> dict[str, int]:
    try:
        lines = path.read_text("ascii", "replace").splitlines()
    except OSError:
        return {}
    words = (line.split() for line in lines)
    return {pair[0]: int(pair[1]) for pair in words if len(pair) == 2 and pair[1].isdigit()}

"""Finds this process's control groups, where Linux keeps limits of containers."""

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

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

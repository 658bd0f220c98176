"""Finds out what takes the room on a working folder's disk."""

import os
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_BLOCK_BYTES = 512
SHOWN = 3


@dataclass(frozen=True)
class Occupied:
    folder: Path
    bytes: int
    what: str


def largest(bucket_folder: Path | None, data: Path) -> list[Occupied]:
    """Models, logs and other folders, the largest first."""
    sizes: dict[tuple[Path, str], int] = defaultdict(int)
    if bucket_folder is not None:
        for bucket in _folders(bucket_folder):
            for folder in _folders(bucket):
                what = "rollouts" if folder.name == "rollouts" else "model"
                sizes[folder, what] += size_on_disk(folder)
    for folder in _folders(data):
        if bucket_folder is None or not _contains(folder, bucket_folder):
            sizes[folder, "logs" if folder.name == "logs" else "files"] += size_on_disk(folder)
    found = [Occupied(folder, size, what) for (folder, what), size in sizes.items() if size]
    return sorted(found, key=lambda one: one.bytes, reverse=True)[:SHOWN]


def size_on_disk(folder: Path) -> int:
    total = 0
    for path, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(Path(path, name)).st_blocks * _BLOCK_BYTES
            except OSError:  # it has been deleted meanwhile
                continue
    return total


def _folders(folder: Path) -> Iterator[Path]:
    try:
        found = sorted(path for path in folder.iterdir() if path.is_dir())
    except OSError:
        return
    yield from found


def _contains(folder: Path, other: Path) -> bool:
    return other.absolute().is_relative_to(folder.absolute())

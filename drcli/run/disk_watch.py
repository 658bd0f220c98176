"""Warns early of full disks, and ends the run while it can be saved."""

import os
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from drcli.base.clock import Trend, duration, elapsed_s
from drcli.base.errors import DiskFull
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import Outcome

# Finds out what takes the room on a working folder's disk.


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


POLL_S = 10.0
LIMIT_SHARE = 0.1
"""A limit is never more than this share of a disk."""

LOW_FACTOR = 3.0
"""Below this many times the limit a disk is low."""

WARNED_S = (24 * 3600.0, 3 * 3600.0, 1200.0)
GREW_BYTES = 20e6
TEMPORARY_BYTES = 50e6
"""For exports and checks."""

LOW_FILES, LEAST_FILES = 20_000, 2_000
"""New files that fit: warn, and end the run."""


@dataclass(frozen=True)
class Disk:
    """`files`: how many new ones fit, None without such a limit."""

    folder: Path
    device: int
    total_bytes: int
    free_bytes: int
    files: int | None


def measure(folder: Path) -> Disk | None:
    """The disk of a folder or its nearest parent; None if it does not answer."""
    try:
        place = next(place for place in (folder, *folder.parents) if place.exists())
        stat = os.statvfs(place)
        device = place.stat().st_dev
    except (OSError, StopIteration):
        return None
    return Disk(
        folder,
        device,
        stat.f_blocks * stat.f_frsize,
        stat.f_bavail * stat.f_frsize,
        stat.f_favail if stat.f_files else None,
    )


class DiskWatch(Duty):
    """Measures in a thread, and reacts in the supervisor's loop."""

    name = "disk watch"
    every_s = POLL_S

    def __init__(
        self,
        run: RunningTraining,
        *,
        clock: Callable[[], float] = elapsed_s,
        measure: Callable[[Path], Disk | None] = measure,
    ) -> None:
        super().__init__(run)
        job, storage = run.job, run.job.config.storage
        self._bucket_folder = storage.data_dir if storage.cloud == "local" else None
        self._data = job.directory / "data"
        self._temporary = Path(tempfile.gettempdir())
        self._min_bytes = 1e6 * job.config.unattended.disk_min_mb
        self._clock = clock
        self._measure = measure
        self._trends: dict[int, Trend] = {}
        self._warned: dict[int, int] = {}
        self._temporary_low = False
        self._disks: Sequence[tuple[Disk, float]] = ()
        self._occupied: Sequence[Occupied] = ()
        self._listed_step = 0

    def work(self) -> None:
        folders = [self._data] if self._bucket_folder is None else [self._bucket_folder, self._data]
        found: dict[int, tuple[Disk, float]] = {}
        for folder in folders:
            disk = self._measure(folder)
            if disk is not None and disk.device not in found:
                found[disk.device] = disk, self._lasts_s(disk)
        disks = list(found.values())
        step = max((self._step_of(disk, lasts_s) for disk, lasts_s in disks), default=0)
        if step > self._listed_step:
            self._listed_step = step
            self._occupied = largest(self._bucket_folder, self._data)
        temporary = self._measure(self._temporary)
        if temporary is not None and temporary.device not in found:
            disks.append((temporary, float("inf")))
        self._disks = disks

    def check(self) -> Outcome | None:
        disks, self._disks = self._disks, ()
        for disk, lasts_s in disks:
            if disk.folder == self._temporary:
                self._look_at_temporary(disk)
            elif outcome := self._look_at(disk, lasts_s):
                return outcome
        return None

    def _lasts_s(self, disk: Disk) -> float:
        trend = self._trends.setdefault(disk.device, Trend())
        trend.add(self._clock(), float(disk.total_bytes - disk.free_bytes))
        growth = trend.growth(GREW_BYTES)
        if growth is None:
            return float("inf")
        return max(0.0, disk.free_bytes - self._limit(disk)) / growth.per_s

    def _limit(self, disk: Disk) -> float:
        return min(self._min_bytes, LIMIT_SHARE * disk.total_bytes)

    def _step_of(self, disk: Disk, lasts_s: float) -> int:
        """0 for far from full, then one more for each time in WARNED_S."""
        step = sum(lasts_s < warned_s for warned_s in WARNED_S)
        low = disk.free_bytes < LOW_FACTOR * max(self._limit(disk), TEMPORARY_BYTES)
        few = disk.files is not None and disk.files < LOW_FILES
        return max(step, int(low or few))

    def _look_at(self, disk: Disk, lasts_s: float) -> Outcome | None:
        files = disk.files
        if self._min_bytes and disk.free_bytes < self._limit(disk):
            what = (
                f"Only {size(disk.free_bytes)} are left on the disk of {disk.folder}. The training "
                "has stopped while everything can still be saved (DR_DISK_MIN_MB; the limit is "
                f"{size(self._limit(disk))})."
            )
            return Outcome(DiskFull.code, f"{what}{self._largest()}", self._remedy(resume=True))
        if self._min_bytes and files is not None and files < LEAST_FILES:
            what = (
                f"The disk of {disk.folder} can take only {files:,} more files. The training has "
                "stopped while everything could still be saved."
            )
            return Outcome(DiskFull.code, f"{what}{self._largest()}", self._remedy(resume=True))
        subject, step = f"disk {disk.device}", self._step_of(disk, lasts_s)
        if step == 0:
            self._warned.pop(disk.device, None)
            self.run.board.clear(subject)
        elif step > self._warned.get(disk.device, 0):
            self._warned[disk.device] = step
            what = f"{size(disk.free_bytes)} are left on the disk of {disk.folder}"
            if files is not None and files < LOW_FILES:
                what += f", and room for {files:,} more files"
            if lasts_s != float("inf"):
                what += f"; at the present rate they last for {duration(lasts_s)}"
            if self._min_bytes:
                what += f". The training stops at {size(self._limit(disk))} (DR_DISK_MIN_MB)"
            self.run.board.warn(
                subject,
                f"{what}.{self._largest()} {self._remedy(resume=False)}",
                folder=str(disk.folder),
                free_bytes=disk.free_bytes,
            )
        return None

    def _look_at_temporary(self, disk: Disk) -> None:
        if disk.free_bytes >= TEMPORARY_BYTES:
            self.run.board.clear("temporary files")
            self._temporary_low = False
        elif not self._temporary_low:
            self._temporary_low = True
            self.run.board.warn(
                "temporary files",
                f"Only {size(disk.free_bytes)} are left in {disk.folder}, the folder for temporary "
                "files: exports and uploads may fail. Delete files there, or set TMPDIR to another "
                "folder.",
            )

    def _largest(self) -> str:
        parts = [f"{one.what} {one.folder} {size(one.bytes)}" for one in self._occupied]
        return f" The largest: {', '.join(parts)}." if parts else ""

    def _remedy(self, *, resume: bool) -> str:
        where = self._bucket_folder or self._data
        ways = [f"Delete models that you no longer need from {where}"]
        if self._bucket_folder is None:
            ways = [f"Delete old files below {where}"]
        ways.append("lower DR_LOG_MAX_MB")
        if self._bucket_folder is not None:
            ways.append("move the folder and set DR_S3_DATA_DIR to its new place")
        end = "; then continue with `dr-start-training --resume`." if resume else "."
        return f"{', '.join(ways[:-1])} or {ways[-1]}{end}"


def size(size_bytes: float) -> str:
    return f"{size_bytes / 1e9:.1f} GB" if size_bytes >= 1e9 else f"{size_bytes / 1e6:.0f} MB"

"""Examines memory and disks."""

import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import psutil

from drcli.base.control_groups import ROOT
from drcli.base.memory_state import group_limits
from drcli.checks.doctor.findings import Finding, State, shown_bytes
from drcli.checks.machine_rules import LEAST_DISK_BYTES, TRAINER_BYTES, WORKER_BYTES

LEAST_INODES = 10_000
"""A long training has some thousands of files."""

LEAST_TEMPORARY_BYTES = 200_000_000
SLOW_DISK_MB_S = 10.0
_TEST_BYTES = 32 << 20
_CHUNK_BYTES = 1 << 20
_TEST_S = 0.8

_NETWORK = ("nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "ceph", "lustre", "glusterfs", "gpfs")
_IN_MEMORY = ("tmpfs", "ramfs")


@dataclass(frozen=True)
class Memory:
    """Bytes; `limit` is that of the container."""

    total: int
    free: int
    swap: int
    limit: int | None


def read_memory(root: Path = ROOT) -> Memory:
    """Of the machine, or less in a container."""
    machine = psutil.virtual_memory()
    total, free = machine.total, machine.available
    limit = None
    for allowed, used in group_limits(root):
        limit = allowed if limit is None else min(limit, allowed)
        free = min(free, max(0, allowed - (used or 0)))
    if limit is not None and limit < total:
        return Memory(limit, free, psutil.swap_memory().total, limit)
    return Memory(total, free, psutil.swap_memory().total, None)


def examine_memory(workers: int, root: Path = ROOT) -> Iterator[Finding]:
    memory = read_memory(root)
    needed = workers * WORKER_BYTES + TRAINER_BYTES
    text = f"{shown_bytes(memory.free)} of {shown_bytes(memory.total)} free"
    if memory.limit is not None:
        text += " (the limit of this container or service)"
    facts = {
        "total_bytes": memory.total,
        "free_bytes": memory.free,
        "limit_bytes": memory.limit,
        "swap_bytes": memory.swap,
        "needed_bytes": needed,
    }
    if memory.free >= needed:
        yield Finding("memory", "ok", text, facts=facts)
        return
    text += f"; a training with DR_WORKERS={workers} takes about {shown_bytes(needed)}."
    remedy = "End other programs, lower DR_WORKERS, or give the container more memory."
    hopeless = memory.total < needed
    yield Finding("memory", "problem" if hopeless else "warning", text, remedy, facts)


def examine_disks(directory: Path, data_dir: Path | None, root: Path = ROOT) -> Iterator[Finding]:
    seen: set[int] = set()
    for folder in dict.fromkeys((directory, data_dir or directory)):
        place = _existing(folder)
        if place is not None and place.stat().st_dev not in seen:
            seen.add(place.stat().st_dev)
            yield _disk(place, folder, local_bucket=data_dir is not None, root=root)
    yield from _temporary()


def file_system(place: Path, root: Path = ROOT) -> str:
    """Such as `ext4`."""
    kind, longest = "", -1
    try:
        lines = (root / "proc/self/mountinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        return ""
    resolved = PurePosixPath(os.path.realpath(place))
    for line in lines:
        before, _, after = line.partition(" - ")
        words = before.split()
        if len(words) < 5 or not after:
            continue
        mounted = words[4].encode("latin-1", "replace").decode("unicode_escape")
        if resolved.is_relative_to(mounted) and len(mounted) >= longest:
            kind, longest = after.split()[0], len(mounted)
    return kind


def _disk(place: Path, folder: Path, *, local_bucket: bool, root: Path) -> Finding:
    space = os.statvfs(place)
    free, total = space.f_bavail * space.f_frsize, space.f_blocks * space.f_frsize
    inodes = space.f_favail if space.f_files else None
    kind = file_system(place, root)
    writable = os.access(place, os.W_OK | os.X_OK) and not space.f_flag & os.ST_RDONLY
    speed = _write_speed_mb_s(place) if writable and free > 2 * _TEST_BYTES else None
    facts = {
        "folder": str(folder),
        "file_system": kind,
        "free_bytes": free,
        "total_bytes": total,
        "free_files": inodes,
        "write_mb_s": speed,
        "writable": writable,
    }
    text = f"{shown_bytes(free)} of {shown_bytes(total)} free"
    text += f" ({kind})" if kind else ""
    text += f", writes {speed:,.0f} MB/s" if speed is not None else ""
    text += f": {folder}"

    def found(state: State, reason: str, remedy: str) -> Finding:
        return Finding("disk", state, f"{text}; {reason}.", remedy, facts)

    elsewhere = "Use a folder on a local disk, or keep the bucket elsewhere (DR_CLOUD)."
    if not writable:
        return found("problem", "nothing can be written there", "Use a folder of your own.")
    if free < LEAST_DISK_BYTES:
        needed = shown_bytes(LEAST_DISK_BYTES)
        remedy = "Delete models or logs, or use a larger disk (DR_S3_DATA_DIR)."
        return found("warning", f"a training may need {needed}", remedy)
    if inodes is not None and inodes < LEAST_INODES:
        reason = f"only {inodes:,} more files can be created (inodes)"
        return found("warning", reason, "Delete folders with many small files.")
    if kind in _NETWORK or kind.startswith("fuse."):
        return found("warning", "it is a file system over a network or in a program", elsewhere)
    if kind in _IN_MEMORY and local_bucket:
        return found("warning", "it is in memory, and empty after a restart", elsewhere)
    if kind == "overlay" and local_bucket:
        remedy = "Mount a volume there, or keep the bucket elsewhere (DR_CLOUD)."
        return found("warning", "it is deleted with the container", remedy)
    if speed is not None and speed < SLOW_DISK_MB_S:
        return found("warning", "that is slow", elsewhere)
    return Finding("disk", "ok", text, facts=facts)


def _write_speed_mb_s(folder: Path) -> float | None:
    """By a file that has no name."""
    block = os.urandom(_CHUNK_BYTES)
    written = 0
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            began_s = time.monotonic()
            while written < _TEST_BYTES and time.monotonic() - began_s < _TEST_S:
                file.write(block)
                written += len(block)
            file.flush()
            os.fsync(file.fileno())
            return written / 1e6 / max(1e-6, time.monotonic() - began_s)
    except OSError:
        return None


def _temporary() -> Iterator[Finding]:
    try:
        folder = Path(tempfile.gettempdir())
        free = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
    except OSError as error:
        text = f"there is no folder for temporary files ({error.strerror or error})."
        yield Finding("disk", "problem", text, "Set TMPDIR to a folder that you can write.")
        return
    if free < LEAST_TEMPORARY_BYTES:
        text = f"only {shown_bytes(free)} are free for temporary files in {folder}."
        yield Finding("disk", "warning", text, "Make room there, or set TMPDIR.")


def _existing(folder: Path) -> Path | None:
    return next((each for each in (folder, *folder.parents) if each.is_dir()), None)

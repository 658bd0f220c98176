"""Calls that Linux, macOS and others do not all have in the same way.

Only this module imports `fcntl` and `resource`, or uses calls of Linux alone; but
`drcli.base.clock` chooses a clock, and `drsim` sets its timers.

On Windows, drcli runs inside WSL.
"""

import errno
import os
import select
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Literal

from drcli.base.errors import NotAvailable

fcntl: ModuleType | None
resource: ModuleType | None
try:
    import fcntl
    import resource
except ImportError:  # Windows
    fcntl = resource = None

_DESCRIPTORS = (Path("/proc/self/fd"), Path("/dev/fd"))
_END_WITH_PARENT, _ADOPT_ORPHANS = 1, 36
"""Source: linux/prctl.h."""

_SOONER = 50
"""As if the process had 5 % more of the memory: see proc_pid_oom_score_adj(5)."""

_ARG_START = 45
"""Place, after the name, of the address of the command line in /proc/self/stat."""

Limit = Literal["open_files", "processes", "memory", "file_size"]

_LIMITS: dict[Limit, str] = {
    "open_files": "RLIMIT_NOFILE",
    "processes": "RLIMIT_NPROC",
    "memory": "RLIMIT_AS",
    "file_size": "RLIMIT_FSIZE",
}

_MANY_FILES = 1 << 40


def try_lock(descriptor: int, *, shared: bool = False) -> bool:
    """Lock until closed; False if another process excludes this one.

    Raises:
        NotAvailable: The system has no such locks.
        OSError: The file system has none.
    """
    if fcntl is None:
        raise no_such_system()
    with suppress(BlockingIOError):
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        return True
    return False


def no_such_system() -> NotAvailable:
    return NotAvailable(
        "drcli does not run on Windows itself, but inside of WSL.",
        remedy="Run `wsl --install`, and install drcli there, as `dr docs platforms` says.",
    )


def soft_limit(limit: Limit) -> int | None:
    """None where unknown."""
    if resource is None or not hasattr(resource, _LIMITS[limit]):
        return None
    found = int(resource.getrlimit(getattr(resource, _LIMITS[limit]))[0])
    unlimited = found < 0 or found == resource.RLIM_INFINITY
    if limit == "open_files":
        unlimited = unlimited or found > _MANY_FILES
    return None if unlimited else found


def peak_memory_bytes() -> int:
    """0 where unknown."""
    if resource is None:
        return 0
    peak = int(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return peak if sys.platform == "darwin" else peak * 1024  # others count in KiB


def limit_data(most_bytes: int) -> bool:
    """Whether the limit is set. macOS may refuse it, and does not keep to it."""
    if resource is None or not hasattr(resource, "RLIMIT_DATA"):
        return False
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    unlimited = hard < 0 or hard == resource.RLIM_INFINITY
    limit = most_bytes if unlimited else min(most_bytes, hard)
    try:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    except (OSError, ValueError):
        return False
    return True


def flush_to_disk(path: Path) -> None:
    """Return when a file, or the names in a folder, would outlive a power cut.

    On macOS, `fsync` leaves data in the disk's memory, so this asks the disk, too. File systems
    that cannot flush are left alone.

    Raises:
        OSError: The path does not exist, or the disk refuses the data.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        flush_descriptor(descriptor)
    finally:
        os.close(descriptor)


def flush_descriptor(descriptor: int) -> None:
    """Like `flush_to_disk`."""
    try:
        os.fsync(descriptor)
        if fcntl is not None and hasattr(fcntl, "F_FULLFSYNC"):
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):
            raise


def is_disk_full(error: OSError) -> bool:
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def cores_of_process() -> int:
    """As of `taskset`."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def open_files(process: int | None = None) -> int:
    """0 where unknown."""
    folders = _DESCRIPTORS if process is None else [Path(f"/proc/{process}/fd")]
    for folder in folders:
        with suppress(OSError), os.scandir(folder) as entries:
            return sum(1 for _ in entries)
    return 0


def name_place(path: Path) -> int:
    """A descriptor that only names a place; outside Linux, it is opened."""
    return os.open(path, getattr(os, "O_PATH", os.O_RDONLY) | os.O_CLOEXEC)


def adopt_orphans(adopts: bool = True) -> None:
    """Become the parent of descendants whose own parent has ended, or no longer; Linux only."""
    _control_process(_ADOPT_ORPHANS, int(adopts))


def end_with_parent() -> None:
    """With the thread that started this process; Linux only."""
    _control_process(_END_WITH_PARENT, signal.SIGKILL)


def _control_process(what: int, value: int) -> None:
    if sys.platform == "linux":
        import ctypes  # loaded here: not every Python has it

        ctypes.CDLL(None).prctl(what, value, 0, 0, 0)


def end_before_others() -> None:
    """Let the system end this process earlier than others if memory runs out; Linux only."""
    with suppress(OSError, ValueError):
        path = Path("/proc/self/oom_score_adj")
        path.write_text(str(min(int(path.read_text()) + _SOONER, 1000)))


def rename_process(words: Sequence[str]) -> None:
    """Let `ps` show these words as the command line after the program, as far as there is room.

    Linux only: elsewhere, the process keeps the name that it was started with.
    """
    with suppress(OSError, ValueError, AttributeError):
        import ctypes

        status = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        begin, end = int(status[_ARG_START]), int(status[_ARG_START + 1])
        program = Path("/proc/self/cmdline").read_bytes().partition(b"\0")[0]
        line = b"\0".join([program, *map(os.fsencode, words)])[: end - begin - 1]
        ctypes.memmove(begin, line.ljust(end - begin, b"\0"), end - begin)


class ExitWait:
    """Waits for the end of any process."""

    def __init__(self, pid: int) -> None:
        """Outside Linux, `wait` only lets the time pass."""
        self._descriptors: list[int] = []
        with suppress(AttributeError, OSError):  # not Linux, or the process has ended
            self._descriptors.append(os.pidfd_open(pid))

    def wait(self, seconds: float) -> None:
        select.select(self._descriptors, [], [], seconds)

    def close(self) -> None:
        while self._descriptors:
            os.close(self._descriptors.pop())

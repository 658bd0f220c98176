"""Identifies machines, and processes whose number may be used again.

Neither the host name nor /etc/machine-id will do: containers made from one image share them. What
matters is whether process numbers mean the same. So the name of a machine is made of the kernel's
random boot id and the namespace of process numbers, which is different in every container.
"""

import os
import socket
from functools import lru_cache
from pathlib import Path

_PROC = Path("/proc")
_START_FIELD = 19
"""Place of the start time in /proc/PID/stat, counted from the state. Source: man 5 proc."""

_UNIX_S = 1e9
"""Larger times count from 1970, smaller ones from the start of the machine."""

_SAME_S = 1.0
"""Two measured start times of one process differ by less than this."""


@lru_cache(maxsize=1)
def this_machine() -> str:
    """A name that is equal only for processes that see each other's numbers."""
    host = socket.gethostname()
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {(_PROC / 'self/ns/pid').readlink()} {host}"
    except OSError:  # not Linux; containers there run on a Linux of their own
        import psutil

        return f"booted {psutil.boot_time():.0f} {host}"


def started_s(pid: int) -> float | None:
    """When a process began; None if it does not exist or is a zombie.

    Returns:
        Seconds since the machine started, which do not change when somebody sets the clock; Unix
        seconds on systems without /proc.
    """
    try:
        after_name = (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
        if after_name[0] in "ZX":
            return None
        return int(after_name[_START_FIELD]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return _started_unix_s(pid)


def exists(pid: int) -> bool:
    """Whether a process of this number runs; a zombie does not."""
    return started_s(pid) is not None


def is_alive(pid: int, began_s: float) -> bool:
    """Whether a process runs and is the one that began at that time (`started_s` or Unix time)."""
    now_s = _started_unix_s(pid) if began_s > _UNIX_S else started_s(pid)
    return now_s is not None and abs(now_s - began_s) < _SAME_S


def _started_unix_s(pid: int) -> float | None:
    import psutil  # rarely needed where /proc exists

    try:
        process = psutil.Process(pid)
        ended = process.status() == psutil.STATUS_ZOMBIE
        return None if ended else process.create_time()
    except (psutil.Error, ValueError, OverflowError):  # the others: not a process id
        return None

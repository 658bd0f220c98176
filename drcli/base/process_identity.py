"""Identifies machines, and processes whose number may be used again.

Containers share host name and /etc/machine-id, so a machine is the kernel's boot id and a namespace
of process numbers.
"""

import os
import socket
from functools import lru_cache
from pathlib import Path

_PROC = Path("/proc")
_START_FIELD = 19
"""Source: man 5 proc."""

_UNIX_S = 1e9
_SAME_S = 1.0


@lru_cache(maxsize=1)
def this_machine() -> str:
    """Equal for processes that see each other's numbers."""
    host = socket.gethostname()
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {(_PROC / 'self/ns/pid').readlink()} {host}"
    except OSError:  # not Linux; containers there run on a Linux of their own
        import psutil

        return f"booted {psutil.boot_time():.0f} {host}"


def started_s(pid: int) -> float | None:
    """Seconds from the machine's start, or Unix time without /proc; None for a zombie."""
    try:
        after_name = (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
        if after_name[0] in "ZX":
            return None
        return int(after_name[_START_FIELD]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return _started_unix_s(pid)


def exists(pid: int) -> bool:
    return started_s(pid) is not None


def is_alive(pid: int, began_s: float) -> bool:
    """Began then (`started_s` or Unix time)."""
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

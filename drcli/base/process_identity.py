"""What tells one machine from another, and one process from a later one with its number.

Neither the host's name nor /etc/machine-id will do: containers made from one image share them. What
matters is whether the numbers of processes mean the same, so the name of a machine is made of what
the kernel draws at random when it starts and the namespace of process numbers, of which every
container has one of its own.
"""

import os
import socket
from functools import lru_cache
from pathlib import Path

_PROC = Path("/proc")
_START_FIELD = 19
"""Place of the start time in /proc/PID/stat, counted from the state. Source: man 5 proc."""

_UNIX_S = 1e9
"""Times from here on count from 1970 and not from the start of the machine."""

_SAME_S = 1.0
"""Times of one process differ by less than this."""


@lru_cache(maxsize=1)
def this_machine() -> str:
    """A name that only processes have that see each other's numbers."""
    host = socket.gethostname()
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {(_PROC / 'self/ns/pid').readlink()} {host}"
    except OSError:  # not Linux; containers there run on a Linux of their own
        import psutil

        return f"booted {psutil.boot_time():.0f} {host}"


def started_s(pid: int) -> float | None:
    """When a process began; None where there is none, or only what is left of one that ended.

    Returns:
        Seconds since the machine started where the kernel tells them: unlike the time of day they
        stay the same when somebody sets the clock. Else Unix seconds.
    """
    try:
        after_name = (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
        if after_name[0] in "ZX":
            return None
        return int(after_name[_START_FIELD]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return _started_unix_s(pid)


def exists(pid: int) -> bool:
    """Whether a process runs; what is left of one that ended does not.

    Args:
        pid: As somebody wrote it down.
    """
    return started_s(pid) is not None


def is_alive(pid: int, began_s: float) -> bool:
    """Whether a process runs and is the one that began then, as `started_s` or Unix time has it."""
    now_s = _started_unix_s(pid) if began_s > _UNIX_S else started_s(pid)
    return now_s is not None and abs(now_s - began_s) < _SAME_S


def _started_unix_s(pid: int) -> float | None:
    import psutil  # loaded here, because where there is /proc it is hardly needed

    try:
        process = psutil.Process(pid)
        ended = process.status() == psutil.STATUS_ZOMBIE
        return None if ended else process.create_time()
    except (psutil.Error, ValueError, OverflowError):  # the others: not a process id
        return None

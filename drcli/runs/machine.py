"""What tells one machine from another, and one process from a later one with its number.

Neither the host's name nor /etc/machine-id will do: containers made from one image share them. What
matters is whether the numbers of processes mean the same, so the name of a machine is made of what
the kernel draws at random when it starts and the namespace of process numbers, of which every
container has one of its own.
"""

import socket
from functools import lru_cache
from pathlib import Path

import psutil

_PROC = Path("/proc")
_START_FIELD = 19
"""Place of the start time in /proc/PID/stat, counted from the state. Source: man 5 proc."""


@lru_cache(maxsize=1)
def this_machine() -> str:
    """A name that only processes have that see each other's numbers."""
    host = socket.gethostname()
    try:
        boot = (_PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {(_PROC / 'self/ns/pid').readlink()} {host}"
    except OSError:  # not Linux; containers there run on a Linux of their own
        return f"booted {psutil.boot_time():.0f} {host}"


def start_of(pid: int) -> str:
    """When a process began; empty where there is none, or only what is left of one that ended.

    In ticks since the machine started where the kernel tells them: they stay the same when somebody
    sets the clock.
    """
    try:
        after_name = (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
        return "" if after_name[0] in "ZX" else f"tick {after_name[_START_FIELD]}"
    except (OSError, IndexError):
        pass
    try:
        process = psutil.Process(pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return ""
        return f"{process.create_time():.0f}"
    except psutil.Error:
        return ""

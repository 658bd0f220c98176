"""Lowers the priority of this process and its descendants."""

import os
import sys
from contextlib import suppress
from pathlib import Path

from drcli.base.backoff import wait_until

NICE = 10
"""A program with 0 gets nine times as much of a core. Source: man 7 sched."""

_GROUP = Path("/proc/self/autogroup")

_GROUP_PATIENCE_S = 1.0


def lower_priority(group: Path = _GROUP) -> str:
    """Let others have processor and disk first, for good; returns what was done.

    Call it before threads start: on Linux, they inherit priority.

    With `sched_autogroup` (most desktops), priority counts within a session only. So the session's
    group gets the same priority, unless others share the session, such as a shell.
    """
    done = []
    with suppress(OSError):
        if os.getpriority(os.PRIO_PROCESS, 0) < NICE:
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
        done.append(f"nice {os.getpriority(os.PRIO_PROCESS, 0)}")
    if os.getsid(0) == os.getpid() and group.exists() and _lower_group(group):
        done.append("its session too")
    if _lower_disk():
        done.append("disk last of its class")
    return ", ".join(done) or "this system allows no other priority"


def _lower_group(group: Path) -> bool:
    def lowered() -> bool:
        try:
            if int(group.read_text("ascii").rpartition(" ")[2]) < NICE:
                group.write_text(str(NICE), "ascii")
        except BlockingIOError:  # another group was changed just now
            return False
        return True

    try:
        return wait_until(lowered, patience_s=_GROUP_PATIENCE_S, last_s=0.2)
    except (OSError, ValueError):
        return False


def _lower_disk() -> bool:
    if sys.platform != "linux":
        return False
    import psutil

    try:
        psutil.Process().ionice(psutil.IOPRIO_CLASS_BE, 7)
    except (psutil.Error, OSError, ValueError):
        return False
    return True

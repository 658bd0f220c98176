"""Makes Python on Linux look like one on another Unix to our code, as far as that is possible.

A process with this folder in PYTHONPATH loads this file when it starts. It takes away calls that
only Linux has, and hides /proc, /sys and control groups from `pathlib` and `os.listdir`, which our
code uses. psutil goes on to read /proc: on macOS it has calls of its own instead.
"""

import os
import pathlib
import select
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

ABSENT: tuple[tuple[Any, tuple[str, ...]], ...] = (
    (os, ("sched_getaffinity", "sched_setaffinity", "pidfd_open", "memfd_create", "eventfd")),
    (os, ("posix_fadvise", "posix_fallocate", "copy_file_range", "getxattr", "setxattr")),
    (os, ("O_TMPFILE", "O_DIRECT", "O_PATH", "process_cpu_count", "getrandom", "splice")),
    (select, ("epoll",)),
    (signal, ("pidfd_send_signal", "sigtimedwait", "sigwaitinfo", "SIGPWR", "SIGSTKFLT")),
    (time, ("CLOCK_BOOTTIME",)),
)
"""Names that Python has on Linux and not on macOS, by module."""

HIDDEN = ("/proc", "/sys")

for module, names in ABSENT:
    for name in names:
        if hasattr(module, name):
            delattr(module, name)


def _hidden(path: object) -> bool:
    text = os.fspath(path) if isinstance(path, (str, os.PathLike)) else ""
    return any(text == root or str(text).startswith(f"{root}/") for root in HIDDEN)


def _without_proc(call: Callable[..., Any]) -> Callable[..., Any]:
    def guarded(path: Any = ".", *arguments: Any, **named: Any) -> Any:
        caller = sys._getframe(1).f_globals.get("__name__", "")
        if _hidden(path) and not caller.startswith("psutil"):
            raise FileNotFoundError(2, "No such file or directory", str(path))
        return call(path, *arguments, **named)

    return guarded


for name in ("open", "stat", "lstat", "readlink", "iterdir", "read_text", "read_bytes"):
    setattr(pathlib.Path, name, _without_proc(getattr(pathlib.Path, name)))
os.listdir = _without_proc(os.listdir)

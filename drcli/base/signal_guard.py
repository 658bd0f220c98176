"""Prevents a racer's code from sending signals to other programs.

`os.kill(os.getppid(), 9)` would end the command. This protects against mistakes only
(docs/security.md).
"""

import errno
import os
import signal
from collections.abc import Callable
from typing import Any

_REFUSAL = (
    "a reward function must not send signals to the program that runs it or to other programs"
)


def install() -> None:
    """In the leader of a process group."""
    os.kill = _guarded(os.kill, _is_own)
    os.killpg = _guarded(os.killpg, _is_own_group)
    if hasattr(signal, "pidfd_send_signal"):  # which process a descriptor means is unknown
        signal.pidfd_send_signal = _guarded(signal.pidfd_send_signal, lambda _descriptor: False)


def _guarded(send: Callable[..., Any], allowed: Callable[[int], bool]) -> Callable[..., Any]:
    def guarded(target: int, *arguments: Any) -> Any:
        if not allowed(target):
            raise PermissionError(errno.EPERM, _REFUSAL)
        return send(target, *arguments)

    return guarded


def _is_own(pid: int) -> bool:
    if pid <= 0:
        return pid != -1 and _is_own_group(-pid)
    return pid == os.getpid() or pid in _children()


def _is_own_group(group: int) -> bool:
    return (group in (0, os.getpid()) and os.getpgrp() == os.getpid()) or group in _children()


def _children() -> set[int]:
    import psutil  # loaded here: hardly any reward function starts a program

    return {child.pid for child in psutil.Process().children(recursive=True)}

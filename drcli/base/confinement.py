"""Takes from a process and its descendants what it need not reach; Linux, without root.

Landlock limits files and signals, and hides other processes; seccomp refuses sockets. Neither can
be undone. Sources: the kernel's pages userspace-api/landlock and userspace-api/seccomp_filter.
"""

import ctypes
import errno
import os
import platform
import signal
import struct
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from drcli.base.installation import lazy_imports
from drcli.base.system_calls import name_place

with lazy_imports():
    import psutil

Freedom = Literal["files", "sockets", "signals"]
FREEDOMS: tuple[Freedom, ...] = ("files", "sockets", "signals")

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_VERSION_FLAG = 1
_BENEATH_PATH = 1
_NO_NEW_PRIVILEGES, _GET_SECCOMP, _SET_SECCOMP, _FILTER = 38, 21, 22, 2

_EXECUTE, _WRITE, _READ, _LIST = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_MAKE_FOLDER, _MAKE_FILE, _TRUNCATE, _CONTROL_DEVICE = 1 << 7, 1 << 8, 1 << 14, 1 << 15
_OF_FILES = _EXECUTE | _WRITE | _READ | _TRUNCATE | _CONTROL_DEVICE
_READING = _EXECUTE | _READ | _LIST
_CREATING = _WRITE | _TRUNCATE | _MAKE_FILE | _MAKE_FOLDER

_RIGHTS = ((1, 13), (2, 14), (3, 15), (5, 16))
"""By version of Landlock."""

_TCP_SINCE, _SCOPES_SINCE = 4, 6
_BIND_AND_CONNECT = 0b11
_ABSTRACT_SOCKETS_AND_SIGNALS = 0b11

_MACHINES = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}
"""Audit name, and number of the call `socket`."""

_IO_URING_SETUP = 425
"""Also opens sockets."""

_X32 = 0x40000000
"""Calls of x86_64 with this bit are numbered anew."""

_LOAD, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_NUMBER, _ARCHITECTURE = 0, 4
_CAPABILITIES_VERSION = 0x20080522
_CHOWN, _DAC_OVERRIDE, _FOWNER = 1 << 0, 1 << 1, 1 << 3
_KEPT = _CHOWN | _DAC_OVERRIDE | _FOWNER
"""Of root. With CAP_PERFMON, a process reads the environment of others although Landlock forbids it
(seen with Linux 6.18).
"""

_ALLOW, _REFUSE = 0x7FFF0000, 0x00050000
_EACCES = 13


def offered() -> set[Freedom]:
    """What the kernel can take."""
    version = _landlock_version()
    found: set[Freedom] = set()
    if version:
        found.add("files")
    if platform.machine() in _MACHINES and _call("prctl", _GET_SECCOMP, 0, 0, 0, 0) >= 0:
        found.add("sockets")
    if version >= _SCOPES_SINCE:
        found.add("signals")
    return found


def confine(
    readable: Iterable[Path], writable: Iterable[Path], creatable: Iterable[Path] = ()
) -> set[Freedom]:
    """Confine this thread and what it starts; returns what could not be taken.

    Args:
        readable: May be read and run; may be missing.
        writable: May also be changed.
        creatable: Files may be made and written to, but neither read nor removed.
    """
    _drop_capabilities()
    taken = offered() if _call("prctl", _NO_NEW_PRIVILEGES, 1, 0, 0, 0) == 0 else set()
    if "files" in taken and not _limit_files(readable, writable, creatable):
        taken -= {"files", "signals"}
    if "sockets" in taken and not _refuse_sockets():
        taken.discard("sockets")
    return set(FREEDOMS) - taken


def _drop_capabilities() -> None:
    header = struct.pack("Ii", _CAPABILITIES_VERSION, 0)
    held = ctypes.create_string_buffer(24)
    if _call("capget", header, ctypes.addressof(held)) == 0:
        effective, permitted = struct.unpack_from("II", held.raw)
        kept = struct.pack("6I", effective & _KEPT, permitted & _KEPT, 0, 0, 0, 0)
        _call("capset", header, kept)


def _limit_files(
    readable: Iterable[Path], writable: Iterable[Path], creatable: Iterable[Path]
) -> bool:
    version = _landlock_version()
    count = max(bits for since, bits in _RIGHTS if version >= since)
    every = (1 << count) - 1
    attributes = struct.pack("Q", every)
    if version >= _TCP_SINCE:
        attributes += struct.pack("Q", _BIND_AND_CONNECT)
    if version >= _SCOPES_SINCE:
        attributes += struct.pack("Q", _ABSTRACT_SOCKETS_AND_SIGNALS)
    rules = _system(_CREATE_RULESET, attributes, len(attributes), 0)
    if rules < 0:
        return False
    try:
        for paths, rights in (
            (readable, _READING),
            (writable, every),
            (creatable, _CREATING & every),
        ):
            for path in paths:
                _allow(rules, path, rights)
        return _system(_RESTRICT_SELF, rules, 0) == 0
    finally:
        os.close(rules)


def _allow(rules: int, path: Path, rights: int) -> None:
    with suppress(OSError):
        place = name_place(path)
        try:
            allowed = rights if path.is_dir() else rights & _OF_FILES
            _system(_ADD_RULE, rules, _BENEATH_PATH, struct.pack("=Qi", allowed, place), 0)
        finally:
            os.close(place)


def _refuse_sockets() -> bool:
    """Pairs of connected ones stay, which `asyncio` needs."""
    architecture, socket = _MACHINES[platform.machine()]
    refuse = _REFUSE | _EACCES
    program = [
        (_LOAD, 0, 0, _ARCHITECTURE),
        (_EQUAL, 0, 4, architecture),
        (_LOAD, 0, 0, _NUMBER),
        (_AT_LEAST, 2, 0, _X32),
        (_EQUAL, 1, 0, socket),
        (_EQUAL, 0, 1, _IO_URING_SETUP),
        (_RETURN, 0, 0, refuse),
        (_RETURN, 0, 0, _ALLOW),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *each) for each in program))
    header = ctypes.create_string_buffer(struct.pack("HP", len(program), ctypes.addressof(code)))
    return _call("prctl", _SET_SECCOMP, _FILTER, ctypes.addressof(header), 0, 0) == 0


def _landlock_version() -> int:
    return max(0, _system(_CREATE_RULESET, None, 0, _VERSION_FLAG))


def _system(number: int, *arguments: int | bytes | None) -> int:
    return _call("syscall", number, *arguments)


def _call(name: str, *arguments: int | bytes | None) -> int:
    if sys.platform != "linux":
        return -1
    words = [ctypes.c_long(each) if isinstance(each, int) else each for each in arguments]
    return int(getattr(ctypes.CDLL(None), name)(*words))


# Prevents a racer's code from sending signals to other programs.
#
# `os.kill(os.getppid(), 9)` would end the command. This protects against mistakes only
# (docs/security.md).


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
    return {child.pid for child in psutil.Process().children(recursive=True)}

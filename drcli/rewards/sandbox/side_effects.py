"""Detects side effects of racers' code, in the sandbox process."""

import builtins
import io
import math
import os
import random
import sys
import time
from collections import Counter
from types import FrameType
from typing import Any

from drcli.rewards.sandbox.sandbox_records import Effect, EffectKind, Printed

_FILE_CHANGES = ("chmod", "chown", "link", "mkdir", "remove", "rename", "rmdir", "symlink")
_EVENTS: dict[EffectKind, tuple[str, ...]] = {
    "writes": (*(f"os.{change}" for change in _FILE_CHANGES), "shutil.", "sqlite3.connect"),
    "network": ("socket.bind", "socket.connect", "socket.gethost", "socket.getaddr", "socket.send"),
    "process": ("os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.system", "subprocess."),
}
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_HARMLESS = ("/dev/", "/proc/", "/sys/")
_LIBRARIES = tuple({f"{sys.prefix}/", f"{sys.base_prefix}/"})
_SHOWN = 80

_SHARED = (builtins, math, random, time)
"""The simulation uses them in the same process."""


class Effects:
    """Of a file."""

    def __init__(self, file: str) -> None:
        self.listening = False
        self.file = file
        self._seen: Counter[tuple[EffectKind, str, int]] = Counter()
        _listen_with(self)

    def noted(self) -> list[Effect]:
        return [Effect(*what, times=times) for what, times in self._seen.items()]

    def hear(self, event: str, args: tuple[Any, ...]) -> None:
        if not self.listening:
            return
        self.listening = False  # what follows may itself be an event
        kind = self._kind_of_open(*args) if event == "open" else _kind_of(event)
        line = line_in(self.file, sys._getframe(2)) if kind else None
        if kind and line is not None:
            self._seen[kind, _what(event, args), line] += 1
        self.listening = True

    def _kind_of_open(self, path: object, mode: str | None, flags: int) -> EffectKind | None:
        if not isinstance(path, str | bytes | os.PathLike):
            return None
        name = os.fsdecode(path)
        if name.startswith(_HARMLESS) or name == self.file:
            return None
        if flags & _WRITING:
            return "writes"
        return None if os.path.realpath(name).startswith(_LIBRARIES) else "reads"


class PrintCounter(io.TextIOBase):
    """Drops all output, so that a flood cannot fill the disk."""

    def __init__(self, file: str) -> None:
        super().__init__()
        self._file = file
        self._lines = self._characters = 0
        self._first: int | None = None

    def writable(self) -> bool:
        return True

    def write(self, text: str, /) -> int:
        if self._first is None:
            self._first = line_in(self._file, sys._getframe(1))
        self._lines += text.count("\n")
        self._characters += len(text)
        return len(text)

    def noted(self) -> Printed:
        return Printed(self._lines, self._characters, self._first)


class Originals:
    """Python's own functions."""

    def __init__(self) -> None:
        self.replaced: list[str] = []
        self._before = [(module, dict(module.__dict__)) for module in _SHARED]

    def restore(self) -> None:
        changed = [
            (module.__name__, name)
            for module, before in self._before
            for name in before
            if name not in module.__dict__ or module.__dict__[name] is not before[name]
        ]
        for module, before in self._before:
            module.__dict__.update(before)
        # Nothing but syntax so far: any function may have been replaced.
        names = [f"{module}.{name}" for module, name in changed]
        self.replaced += [name for name in names if name not in self.replaced]


def line_in(file: str, frame: FrameType | None) -> int | None:
    """None if the file is not running, or imports."""
    while frame is not None:
        name = frame.f_code.co_filename
        if name == file:
            return frame.f_lineno
        if name.startswith("<frozen importlib"):
            return None
        frame = frame.f_back
    return None


def _kind_of(event: str) -> EffectKind | None:
    return next((kind for kind, starts in _EVENTS.items() if event.startswith(starts)), None)


def _what(event: str, args: tuple[Any, ...]) -> str:
    if event.startswith("socket."):
        return _shown(args[0] if event.startswith("socket.get") else args[1])
    if event.startswith(_EVENTS["process"]):
        return _shown(args[0]) if args else ""
    paths = args[:1] if event == "open" else args[:2]
    return ", ".join(_shown(path) for path in paths if isinstance(path, str | bytes | os.PathLike))


def _shown(value: object) -> str:
    text = os.fsdecode(value) if isinstance(value, bytes) else str(value)
    return text if len(text) <= _SHOWN else f"...{text[-_SHOWN:]}"


_listening: list[Effects] = []
"""Python cannot remove an audit hook, so there is only one."""


def _listen_with(effects: Effects) -> None:
    if not _listening:
        sys.addaudithook(lambda event, args: _listening[-1].hear(event, args))
    _listening[:] = [effects]

"""Notices what racers' code does beside returning a number. Works in a process of its own only."""

import io
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FrameType, FunctionType, ModuleType
from typing import Any

from drcli.checks.sandbox.statement import Effect, EffectKind, Growth, Printed

_EVENTS: dict[str, EffectKind] = {
    "os.chmod": "writes",
    "os.chown": "writes",
    "os.link": "writes",
    "os.mkdir": "writes",
    "os.remove": "writes",
    "os.rename": "writes",
    "os.rmdir": "writes",
    "os.symlink": "writes",
    "os.truncate": "writes",
    "shutil.copyfile": "writes",
    "shutil.move": "writes",
    "shutil.rmtree": "writes",
    "socket.bind": "network",
    "socket.connect": "network",
    "socket.getaddrinfo": "network",
    "socket.gethostbyname": "network",
    "socket.sendmsg": "network",
    "socket.sendto": "network",
    "sqlite3.connect": "writes",
    "os.exec": "process",
    "os.fork": "process",
    "os.forkpty": "process",
    "os.posix_spawn": "process",
    "os.spawn": "process",
    "os.system": "process",
    "subprocess.Popen": "process",
}
"""Events that Python reports to audit hooks. They say what is done, however it is written."""

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_HARMLESS = ("/dev/", "/proc/", "/sys/")
_IMPORTING = "<frozen importlib"
_MOST_COUNTED = 500_000
"""Things counted in globals at most: enough to see growth, soon done."""


class Effects:
    """Listens to what a file of Python does, from now until the process ends.

    Attributes:
        listening: Whether it takes note.
    """

    def __init__(self, file: str) -> None:
        self.listening = False
        self._file = file
        self._seen: Counter[tuple[EffectKind, str, int]] = Counter()
        self._libraries = tuple({f"{sys.prefix}/", f"{sys.base_prefix}/"})
        sys.addaudithook(self._hear)

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Listen to threads and waiting too, of which Python 3.11 reports nothing."""
        threads: Any = threading.Thread
        clock: Any = time
        start, sleep = threads.start, clock.sleep

        def heard_start(thread: threading.Thread) -> None:
            self._note("thread", "", sys._getframe(1))
            start(thread)

        def heard_sleep(seconds: float, /) -> None:
            self._note("waits", f"{seconds:g} s", sys._getframe(1))
            sleep(seconds)

        threads.start, clock.sleep = heard_start, heard_sleep
        try:
            yield
        finally:
            threads.start, clock.sleep = start, sleep

    def noted(self) -> list[Effect]:
        """What it did, in the order in which it began to."""
        return [
            Effect(kind=kind, what=what, line=line, times=times)
            for (kind, what, line), times in self._seen.items()
        ]

    def _hear(self, event: str, args: tuple[Any, ...]) -> None:
        if not self.listening or not (event == "open" or event in _EVENTS):
            return
        kind = _EVENTS.get(event)
        if kind is None:
            kind = self._kind_of_open(*args)
        if kind is None:
            return
        self.listening = False  # what follows may itself be an event
        self._note(kind, _what(event, args), sys._getframe(1), asked=True)
        self.listening = True

    def _note(self, kind: EffectKind, what: str, frame: FrameType, *, asked: bool = False) -> None:
        line = line_in(self._file, frame) if self.listening or asked else None
        if line is not None:
            self._seen[kind, what, line] += 1

    def _kind_of_open(self, path: object, mode: str | None, flags: int) -> EffectKind | None:
        if not isinstance(path, str | bytes | os.PathLike):
            return None
        name = os.fsdecode(path)
        if name.startswith(_HARMLESS) or name == self._file:
            return None
        if flags & _WRITING:
            return "writes"
        return None if os.path.realpath(name).startswith(self._libraries) else "reads"


class Listener(io.TextIOBase):
    """Counts what is printed, and drops it: a flood must fill no disk.

    Args:
        file: The racer's file.
    """

    def __init__(self, file: str) -> None:
        super().__init__()
        self.calls = 0
        self._file = file
        self._lines = self._characters = 0
        self._first: int | None = None

    def writable(self) -> bool:
        """It takes everything."""
        return True

    def write(self, text: str, /) -> int:
        """Take note of a text."""
        if self._first is None:
            self._first = line_in(self._file, sys._getframe(1))
        self._lines += text.count("\n")
        self._characters += len(text)
        return len(text)

    @property
    def characters(self) -> int:
        """How many there were so far."""
        return self._characters

    def noted(self) -> Printed:
        """What there was."""
        return Printed(
            lines=self._lines, characters=self._characters, line=self._first, calls=self.calls
        )


def line_in(file: str, frame: FrameType | None) -> int | None:
    """The line of a file that is being carried out; None if it is none of its doing, or imports."""
    while frame is not None:
        name = frame.f_code.co_filename
        if name == file:
            return frame.f_lineno
        if name.startswith(_IMPORTING):
            return None
        frame = frame.f_back
    return None


def sizes(module: Mapping[str, Any]) -> dict[str, int]:
    """How many things each global of a module holds, its functions and classes included."""
    left = _MOST_COUNTED
    found = {}
    for name, value in module.items():
        if name.startswith("__"):
            continue
        found[name] = _count(value, left, module)
        left = max(left - found[name], 0)
    return found


def growth(before: Mapping[str, int], after: Mapping[str, int], calls: int) -> list[Growth]:
    """The globals that hold more than before, by at least one thing in a hundred calls."""
    return [
        Growth(name=name, before=before.get(name, 0), after=size, calls=calls)
        for name, size in after.items()
        if size - before.get(name, 0) > calls / 100
    ]


def _count(value: Any, most: int, module: Mapping[str, Any]) -> int:
    """Things within a value, itself not counted; never more than about `most`."""
    seen: set[int] = set()
    waiting, count = [value], 0
    while waiting and count <= most:
        item = waiting.pop()
        if id(item) in seen or isinstance(item, ModuleType):
            continue
        seen.add(id(item))
        if isinstance(item, str | bytes | bytearray):
            count += len(item)
            continue
        inside = _inside(item, module)
        count += len(inside) + _numbers(item)
        waiting += inside
    return count


def _inside(item: Any, module: Mapping[str, Any]) -> list[Any]:
    if isinstance(item, Mapping):
        return [*item.keys(), *item.values()]
    if isinstance(item, FunctionType):
        if item.__globals__ is not module:
            return []
        cells = [cell.cell_contents for cell in item.__closure__ or () if not _is_empty(cell)]
        return [*vars(item).values(), *(item.__defaults__ or ()), *cells]
    if isinstance(item, list | tuple | set | frozenset) or type(item).__name__ == "deque":
        return list(item)
    own = getattr(item, "__dict__", None)
    if own and getattr(item, "__module__", None) == module.get("__name__"):
        return list(own.values())
    return []


def _is_empty(cell: Any) -> bool:
    try:
        cell.cell_contents  # noqa: B018
    except ValueError:
        return True
    return False


def _numbers(item: Any) -> int:
    """Numbers in an array, of whatever library."""
    size = getattr(item, "size", None)
    return size if isinstance(size, int) else 0


def _what(event: str, args: tuple[Any, ...]) -> str:
    """Which file, address or program an event is about."""
    if event.startswith(("socket.connect", "socket.bind", "socket.send")):
        return _shown(args[1])
    if event == "os.posix_spawn" or event.startswith(("os.exec", "os.system", "subprocess")):
        return _shown(args[0])
    if event.startswith("os.fork"):
        return ""
    paths = args[:1] if event == "open" else args[:2]
    return ", ".join(_shown(path) for path in paths if isinstance(path, str | bytes | os.PathLike))


def _shown(value: object) -> str:
    text = os.fsdecode(value) if isinstance(value, bytes) else str(value)
    return text if len(text) <= 80 else f"...{text[-80:]}"

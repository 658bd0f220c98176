"""Finds out whether cars would share state outside of their copies of the file.

Copies of this process, made before it loads the racer's code, call the function twice for one car
alone, and twice for two in turn. If the first car gets other rewards only beside another, they
share something. Random numbers have the same seed; what depends on the time is not judged.
"""

import builtins
import io
import json
import math
import os
import random
import select
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from time import monotonic
from types import FrameType, FunctionType, ModuleType
from typing import Any

from drcli.base.json_record import RecordError, decode_json
from drcli.rewards.sandbox.run_sandbox import Effect, EffectKind, Printed, SharedState
from drsim.episode.load_reward import load_reward_function
from drsim.episode.reward import USER_MODULE, RewardParams, checked_reward
from drsim.errors import RewardError

_PASS_S = 1.0
_PATIENCE_S = 20.0
_MOST_CALLS = 300
_PIECE = 1 << 16


class SharedStateTrial:
    """A copy of this process; a context manager ends it."""

    def __init__(self, file: Path, calls: Sequence[Sequence[RewardParams]]) -> None:
        self._before = set(sys.modules)
        self._copy = _Copy(lambda loaded: _judged(file, calls, loaded))

    def __enter__(self) -> "SharedStateTrial":
        return self

    def __exit__(self, *_: object) -> None:
        self._copy.end()

    def result(self) -> SharedState | None:
        """None for nothing, and where it cannot be told."""
        try:
            loaded = [name for name in sys.modules if name not in self._before]
            return decode_json(SharedState, self._copy.answer(" ".join(loaded), _PATIENCE_S))
        except RecordError:  # it ended, or took too long
            return None


class _Copy:
    """Does one thing, answers in JSON, and ends without a trace."""

    def __init__(self, work: Callable[[str], object]) -> None:
        go, self._go = os.pipe()
        self._read, write = os.pipe()
        self._pid = os.fork()
        if self._pid:
            os.close(go)
            os.close(write)
            return
        try:
            os.close(self._go)
            os.close(self._read)
            with os.fdopen(go) as told:
                answer = json.dumps(work(told.readline())).encode()
            while answer:
                answer = answer[os.write(write, answer) :]
        finally:
            os.kill(os.getpid(), signal.SIGKILL)  # nothing of this process ends twice

    def answer(self, told: str, within_s: float) -> bytes:
        """Nothing if it takes longer."""
        said, end_s = b"", monotonic() + within_s
        with suppress(BrokenPipeError):
            os.write(self._go, f"{told}\n".encode())
        while select.select([self._read], [], [], max(0.0, end_s - monotonic()))[0]:
            piece = os.read(self._read, _PIECE)
            if not piece:
                return said
            said += piece
        return b""

    def end(self) -> None:
        os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)
        os.close(self._go)
        os.close(self._read)


def _judged(
    file: Path, calls: Sequence[Sequence[RewardParams]], loaded: str
) -> dict[str, Any] | None:
    for name in loaded.split():
        if name != USER_MODULE:
            with suppress(Exception):
                import_module(name)
    own = calls[0][:_MOST_CALLS]
    other = (calls[1] if len(calls) > 1 else calls[0][::-1])[:_MOST_CALLS]
    alone, beside = _in_copy(file, own), _in_copy(file, own, other)
    if alone is None or beside is None:
        return None
    pairs = [*zip(alone["values"], beside["values"], strict=False)]
    wrong = sum(a != b for a, b in pairs)
    if not wrong:
        return None  # as nearly always, and another two passes would take as long
    again, once_more = _in_copy(file, own), _in_copy(file, own, other, named=True)
    if again is None or once_more is None:
        return None
    if not (_alike(alone, again) and _alike(beside, once_more)):
        return None
    return {"names": once_more["names"], "times": wrong, "of": len(pairs)}


def _alike(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return all(a == b for a, b in zip(one["values"], other["values"], strict=False))


def _in_copy(
    file: Path,
    own: Sequence[RewardParams],
    other: Sequence[RewardParams] = (),
    *,
    named: bool = False,
) -> dict[str, Any] | None:
    copy = _Copy(lambda _: _played(file, own, other, named=named))
    try:
        return decode_json(dict[str, Any], copy.answer("", _PATIENCE_S))
    except RecordError:
        return None
    finally:
        copy.end()


def _played(
    file: Path, own: Sequence[RewardParams], other: Sequence[RewardParams], *, named: bool
) -> dict[str, Any]:
    """`named`: with the names of what changes, which takes 0.1 s."""
    before = dict(_elsewhere()) if named else {}
    car, beside = load_reward_function(file), load_reward_function(file) if other else None
    before = (dict(_elsewhere()) if named else {}) | before
    loaded = set(sys.modules)
    values, end_s = [], monotonic() + _PASS_S
    for number, params in enumerate(own):
        if monotonic() > end_s:
            break
        values.append(_reward(car, params, number))
        if beside is not None and number < len(other):
            _reward(beside, other[number], -1 - number)
    names = {
        name
        for name, (module, value) in (_elsewhere() if named else ())
        if module in loaded and (name not in before or before[name][1] is not value)
    }
    return {"values": values, "names": sorted(names)}


def _reward(function: Callable[[RewardParams], float], params: RewardParams, seed: int) -> Any:
    random.seed(seed)
    if numpy := sys.modules.get("numpy"):
        numpy.random.seed(seed % (1 << 32))
    with suppress(RewardError):
        return checked_reward(function, copied(params), _PASS_S)
    return None


def copied(params: RewardParams) -> RewardParams:
    """Lists too, which a reward function may alter."""
    return {
        name: _copied_list(value) if type(value) is list else value
        for name, value in params.items()
    }


def _copied_list(values: list[Any]) -> list[Any]:
    """Nearly all time of a call went into waypoints, which are tuples."""
    if values and type(values[0]) is list:
        return [item.copy() for item in values]
    return values.copy()


def _elsewhere() -> Iterator[tuple[str, tuple[str, Any]]]:
    for module in [*sys.modules.values()]:
        if not isinstance(module, ModuleType) or module.__name__ == USER_MODULE:
            continue
        for name, value in [*vars(module).items()]:
            if not name.startswith("__") and not isinstance(
                value, ModuleType | FunctionType | type
            ):
                yield f"{module.__name__}.{name}", (module.__name__, value)
    for name, value in os.environ.items():
        yield f'os.environ["{name}"]', ("os", sys.intern(value))


# Detects side effects of racers' code, in the sandbox process.


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
        altered = [pair for pair in self._before if pair[0].__dict__ != pair[1]]
        changed = [
            (module.__name__, name)
            for module, before in altered
            for name in before
            if name not in module.__dict__ or module.__dict__[name] is not before[name]
        ]
        for module, before in altered:
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

"""Finds out whether cars would share state outside of their copies of the file.

Copies of this process, made before it loads the racer's code, call the function twice for one car
alone, and twice for two in turn. If the first car gets other rewards only beside another, they
share something. Random numbers have the same seed; what depends on the time is not judged.
"""

import json
import os
import random
import select
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from time import monotonic
from types import FunctionType, ModuleType
from typing import Any

from drcli.base.json_record import RecordError, from_json, parse_json
from drcli.rewards.sandbox.sandbox_records import SharedState
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
            answer = parse_json(self._copy.answer(" ".join(loaded), _PATIENCE_S))
            return None if answer is None else from_json(SharedState, answer)
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
    alone, again = (_in_copy(file, own) for _ in range(2))
    if alone is None or again is None or not _alike(alone, again):
        return None
    beside, once_more = (_in_copy(file, own, other) for _ in range(2))
    if beside is None or once_more is None or not _alike(beside, once_more):
        return None
    pairs = [*zip(alone["values"], beside["values"], strict=False)]
    wrong = sum(a != b for a, b in pairs)
    return {"names": beside["names"], "times": wrong, "of": len(pairs)} if wrong else None


def _alike(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return all(a == b for a, b in zip(one["values"], other["values"], strict=False))


def _in_copy(
    file: Path, own: Sequence[RewardParams], other: Sequence[RewardParams] = ()
) -> dict[str, Any] | None:
    copy = _Copy(lambda _: _played(file, own, other))
    try:
        played: dict[str, Any] | None = parse_json(copy.answer("", _PATIENCE_S))
        return played
    except RecordError:
        return None
    finally:
        copy.end()


def _played(
    file: Path, own: Sequence[RewardParams], other: Sequence[RewardParams]
) -> dict[str, Any]:
    before = dict(_elsewhere()) if other else {}
    car, beside = load_reward_function(file), load_reward_function(file) if other else None
    before = (dict(_elsewhere()) if other else {}) | before
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
        for name, (module, value) in (_elsewhere() if other else ())
        if module in loaded and (name not in before or before[name][1] is not value)
    }
    return {"values": values, "names": sorted(names)}


def _reward(function: Callable[[RewardParams], float], params: RewardParams, seed: int) -> Any:
    random.seed(seed)
    if numpy := sys.modules.get("numpy"):
        numpy.random.seed(seed % (1 << 32))
    with suppress(RewardError):
        return checked_reward(function, _copied(params), _PASS_S)
    return None


def _copied(params: RewardParams) -> RewardParams:
    return {key: [*each] if isinstance(each, list) else each for key, each in params.items()}


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

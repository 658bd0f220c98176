"""Calls a user's reward function with a deadline, and names the line that failed."""

import ast
import inspect
import linecache
import math
import os
import sys
import traceback
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import repeat
from pathlib import Path
from time import perf_counter  # the function itself: users' code may replace `time.perf_counter`
from types import CodeType, FrameType, TracebackType
from typing import Any, NamedTuple, NoReturn

from drsim.episode.reward_deadline import DeadlinePassed, alarm, end_copy_of
from drsim.errors import DiscardEpisode, RewardError, RewardErrorKind

RewardParams = dict[str, Any]
RewardFunction = Callable[[RewardParams], float]
OnRewardError = Callable[[int, RewardError], float]
"""From a call's number and failure to the reward instead, or it raises."""

REWARD_DEADLINE_S = 5.0
"""Of one call. Source: the console's validator."""

REWARD_LIMIT = 1e5
"""Either way. Source: the reference simulator."""


USER_MODULE = "_drsim_reward_function"


class Rewarded(NamedTuple):
    rewards: list[float]
    seconds: list[float]


class RewardHost(ABC):
    """Reward functions that are called elsewhere."""

    @abstractmethod
    def rewards(
        self,
        cars: Sequence[int],
        calls: Iterable[RewardParams],
        deadline_s: float,
        on_error: OnRewardError,
    ) -> Rewarded:
        """Call the function of each of these cars, as `checked_rewards` does."""

    @abstractmethod
    def close(self) -> None:
        """No call follows."""


def checked_reward(
    function: RewardFunction, params: RewardParams, deadline_s: float = REWARD_DEADLINE_S
) -> float:
    """Call a reward function once, as `checked_rewards` does."""
    return checked_rewards(function, [params], deadline_s).rewards[0]


def checked_rewards(
    functions: RewardFunction | Iterable[RewardFunction],
    calls: Iterable[RewardParams],
    deadline_s: float = REWARD_DEADLINE_S,
    on_error: OnRewardError | None = None,
    now: Callable[[], float] = perf_counter,
) -> Rewarded:
    """Call a reward function once for each car, and measure each call.

    The deadline uses a timer signal: only in the main thread, where the system has such timers. A
    function that swallows the exceptions at its deadline for seconds, or an operation that Python
    cannot interrupt (by `reward_deadline.STUCK`), ends the process.

    Without `on_error`, the first failure ends the calls; a missed deadline always does.

    Raises:
        RewardError: The function raised, was late, or returned something that is not a finite
            number within +-1e5.
    """
    rewards: list[float] = []
    seconds: list[float] = []
    process = os.getpid()
    each = repeat(functions) if callable(functions) else functions
    with alarm(deadline_s, partial(end_for, _late(deadline_s))) as clock:
        for params, function in zip(calls, each, strict=False):
            try:
                clock.begin()
                begun_s = now()
                try:
                    value = function(params)
                finally:
                    took_s = now() - begun_s
                    end_copy_of(process)
                # Most functions return a float within the limits: one comparison, no call.
                if type(value) is not float or not -REWARD_LIMIT <= value <= REWARD_LIMIT:
                    value = _number(value)
                clock.armed = False
            except BaseException as error:
                clock.armed = False
                if isinstance(error, KeyboardInterrupt):
                    raise  # the user wants to end
                failure = _failure(function, params, error, deadline_s)
                if on_error is None or failure.kind == "endless":
                    raise failure from failure.__cause__
                value = on_error(len(rewards), failure)
            rewards.append(value)
            seconds.append(took_s)
    return Rewarded(rewards, seconds)


def as_number(value: object) -> float | None:
    """A returned value as a float, infinite if too large; None if it is not a number.

    Booleans are numbers.
    """
    if isinstance(value, str | bytes | complex) or not hasattr(value, "__float__"):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf
    except Exception:  # whatever a class of theirs raises
        return None


def centre_line_reward(params: RewardParams) -> float:
    """Reward for staying near the centre line, as in the reference's evaluation jobs."""
    width_m = params["track_width"]
    distance_m = params["distance_from_center"]
    if distance_m <= 0.1 * width_m:
        return 1.0
    if distance_m <= 0.25 * width_m:
        return 0.5
    if distance_m <= 0.5 * width_m:
        return 0.1
    return 0.001


class _NoRewardError(Exception):
    def __init__(self, reason: str, kind: RewardErrorKind) -> None:
        super().__init__(reason)
        self.kind = kind


def _number(value: object) -> float:
    number = as_number(value)
    if number is None:
        raise _NoRewardError(f"it returned {shown(value)}, which is not a number", "type")
    if not -REWARD_LIMIT <= number <= REWARD_LIMIT:  # false for NaN as well
        reason = f"it returned {number}; rewards must lie between -100000 and 100000"
        raise _NoRewardError(reason, "range")
    return number


def _late(deadline_s: float) -> str:
    return f"it did not return within {deadline_s:g} s"


def end_for(what: str, frame: FrameType | None) -> NoReturn:
    """End this process, whose code swallows every exception."""
    while frame is not None and frame.f_globals.get("__name__") != USER_MODULE:
        frame = frame.f_back
    path, line = (Path(frame.f_code.co_filename), frame.f_lineno) if frame else (None, None)
    why = "and swallows what is raised to end it, an `except:` in an endless loop?"
    error = RewardError(
        f"The reward function{place(path, line)} failed: {what} {why}{quoted(path, line)}",
        file=path,
        line=line,
        source=source(path, line),
        kind="endless",
        reason=f"The reward function failed: {what} {why}",
    )
    try:
        sys.excepthook(RewardError, error, None)
    finally:
        os._exit(1)


def _failure(
    function: RewardFunction, params: RewardParams, error: BaseException, deadline_s: float
) -> RewardError:
    code = code_of(function)
    path = Path(code.co_filename) if code else None
    line = line_in(code.co_filename, error.__traceback__) if code else None
    kind: RewardErrorKind = "raises"
    if isinstance(error, _NoRewardError):
        line = code.co_firstlineno if code else None
        kind, what = error.kind, str(error)
    elif isinstance(error, DeadlinePassed):
        kind = "endless"
        what = f"{_late(deadline_s)}, probably an endless loop"
    else:
        what = described(error)
        if any(each.__name__ == DiscardEpisode.__name__ for each in type(error).__mro__):
            kind = "discard"
    short = compact(params, path)
    told = f"\n  params = {short}" if short else ""
    failure = RewardError(
        f"The reward function{place(path, line)} failed: {what}.{quoted(path, line)}{told}",
        file=path,
        line=line,
        source=source(path, line),
        params=short,
        kind=kind,
        reason=what,
    )
    failure.__cause__ = None if isinstance(error, _NoRewardError | DeadlinePassed) else error
    return failure


LONGEST_TEXT = 300
LONGEST_VALUE = 100


def code_of(function: Callable[..., Any]) -> CodeType | None:
    try:
        inner: Any = inspect.unwrap(function)
    except ValueError:  # it is wrapped in itself
        return None
    while isinstance(inner, partial):
        inner = inner.func
    if not hasattr(inner, "__code__"):
        # The code of `__call__`. The linter takes this for a test whether the object is callable.
        inner = getattr(type(inner), "__call__", None)  # noqa: B004
    return getattr(inner, "__code__", None)


def line_in(filename: str, trace: TracebackType | None) -> int | None:
    lines = [
        line for frame, line in traceback.walk_tb(trace) if frame.f_code.co_filename == filename
    ]
    return lines[-1] if lines else None


def place(path: Path | None, line: int | None) -> str:
    """The part " in FILE, line N," of a sentence; empty if unknown."""
    if path is None:
        return ""
    return f" in {path}, line {line}," if line else f" in {path}"


def source(path: Path | None, line: int | None) -> str:
    return _printable(linecache.getline(str(path), line).strip()) if path and line else ""


def quoted(path: Path | None, line: int | None) -> str:
    text = source(path, line)
    return f"\n  {text}" if text else ""


def described(error: BaseException) -> str:
    kind = type(error).__name__
    try:
        text = " ".join(str(error).split())
    except Exception:  # its own method fails
        text = ""
    if len(text) > LONGEST_TEXT:
        text = f"{text[:LONGEST_TEXT]}..."
    return f"{kind}: {_printable(text)}" if text else kind


def shown(value: object) -> str:
    """`repr`, or the type where that is long, fails or contains an address."""
    text = _written(value)
    return f"an object of type {type(value).__qualname__}" if text is None else text


@lru_cache(maxsize=8)
def names_in(text: str) -> frozenset[str]:
    """Words in quotes and arguments of functions, so all parameters that a file reads."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return frozenset()
    quoted_words = {str(node.value) for node in nodes if isinstance(node, ast.Constant)}
    return frozenset(quoted_words | {node.arg for node in nodes if isinstance(node, ast.arg)})


def compact(params: Mapping[str, Any], path: Path | None) -> dict[str, Any]:
    """The parameters that a file reads, shortened; waypoints are told by number.

    The user's code may have put anything among them.
    """
    text = "" if path is None else "".join(linecache.getlines(str(path)))
    short: dict[str, Any] = {}
    for key, value in params.items():
        if text and key not in names_in(text):
            continue
        if key == "waypoints" and type(value) is list:
            short[key] = f"<{len(value)} points>"
        else:
            plain = _rounded(value, 2)
            short[_rounded(key, 0)] = shown(value) if _written(plain) is None else plain
    return short


def _rounded(value: object, depth: int) -> Any:
    if type(value) is float:
        return round(value, 4)
    if type(value) in (bool, int, str, type(None)):
        return value
    if depth and isinstance(value, list | tuple) and len(value) <= LONGEST_VALUE:
        return [_rounded(item, depth - 1) for item in value]
    return shown(value)


def _written(value: object) -> str | None:
    try:
        text = repr(value)
    except Exception:  # its own method fails, or an integer has thousands of digits
        return None
    if not text or len(text) > LONGEST_VALUE or " at 0x" in text:
        return None
    return _printable(text)


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)

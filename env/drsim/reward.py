"""The user's reward function: loading it, calling it safely, and naming the line that failed."""

import contextlib
import importlib.util
import inspect
import linecache
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from itertools import repeat
from pathlib import Path
from types import CodeType, FrameType, ModuleType, TracebackType
from typing import Any, NoReturn

from drsim.errors import RewardError

RewardParams = dict[str, Any]
RewardFunction = Callable[[RewardParams], float]

REWARD_DEADLINE_S = 5.0
"""How long one call may take. Source: the limit of the console's validator."""

REWARD_LIMIT = 1e5
"""Rewards beyond +-1e5 end the run. Source: the reference simulator."""

_IMPORT_DEADLINE_S = 60.0
"""Importing scientific packages may take seconds; an endless loop at the top of the file does not
end."""

_FUNCTION_NAME = "reward_function"
_MODULE_NAME = "_drsim_reward_function"


def load_reward_function(path: Path) -> RewardFunction:
    """Load `reward_function` from a user's file.

    The file becomes a module of a private name, and its folder is not added to the import path.
    What it keeps in module globals lives as long as the process, across episodes.

    Args:
        path: A Python file that defines `reward_function(params)`.

    Returns:
        The function, unguarded: call it through `checked_reward`.

    Raises:
        RewardError: The file is missing, does not parse, fails while it is imported, or has no
            function of that name that takes one argument.
    """
    try:
        source = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RewardError(
            f"The reward function cannot be read: {path} ({error.strerror}).", file=path
        ) from error
    except UnicodeDecodeError as error:
        raise RewardError(f"{path} is not a text file in UTF-8: {error}.", file=path) from error
    try:
        code = compile(source, str(path), "exec")
    except (SyntaxError, ValueError) as error:
        _raise_syntax(path, error)
    module = _run_module(path, code)
    function = getattr(module, _FUNCTION_NAME, None)
    if not callable(function):
        raise RewardError(
            f"{path} defines no function `{_FUNCTION_NAME}`. Add `def {_FUNCTION_NAME}(params):`.",
            file=path,
        )
    _check_arity(path, function)
    checked: RewardFunction = function
    return checked


def checked_reward(
    function: RewardFunction, params: RewardParams, deadline_s: float = REWARD_DEADLINE_S
) -> float:
    """Call a reward function once, guarded as in `checked_rewards`."""
    return checked_rewards(function, [params], deadline_s)[0]


def checked_rewards(
    functions: RewardFunction | Iterable[RewardFunction],
    calls: Iterable[RewardParams],
    deadline_s: float = REWARD_DEADLINE_S,
) -> list[float]:
    """Call a reward function once for each car.

    The deadline rests on a timer signal, so it exists only in the main thread and only where the
    system has such timers; elsewhere the calls are made without it.

    Args:
        functions: The user's function, or one for each call.
        calls: Parameters of each call; the function may keep and alter them.
        deadline_s: How long one call may take, in seconds.

    Returns:
        The rewards, in the order of the calls.

    Raises:
        RewardError: The function raised, did not return in time, or returned something that is no
            finite number within +-1e5. Carries the place and the parameters.
    """
    rewards = []
    each = repeat(functions) if callable(functions) else functions
    with _alarm() as arm:
        for params, function in zip(calls, each, strict=False):
            arm(deadline_s)
            try:
                value = function(params)
                # Most functions return a float within the limits: one comparison, no call.
                if type(value) is not float or not -REWARD_LIMIT <= value <= REWARD_LIMIT:
                    value = _number(value)
            except (Exception, SystemExit, _DeadlinePassed) as error:
                arm(0.0)
                _raise_failed(function, params, error, deadline_s)
            rewards.append(value)
        arm(0.0)
    return rewards


def centre_line_reward(params: RewardParams) -> float:
    """Reward for staying near the centre line, the one evaluation jobs of the reference use."""
    width_m = params["track_width"]
    distance_m = params["distance_from_center"]
    if distance_m <= 0.1 * width_m:
        return 1.0
    if distance_m <= 0.25 * width_m:
        return 0.5
    if distance_m <= 0.5 * width_m:
        return 0.1
    return 0.001


class _DeadlinePassed(BaseException):
    """Raised inside the user's function; no `except Exception` of theirs may swallow it."""


class _NoRewardError(Exception):
    """The value returned is no reward; the text says why."""


def _run_module(path: Path, code: CodeType) -> ModuleType:
    spec = importlib.util.spec_from_loader(_MODULE_NAME, loader=None, origin=str(path))
    if spec is None:  # never for a spec without a loader, but the signature allows it
        raise RewardError(f"{path} cannot be made a module.", file=path)
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    # Dataclasses and pickling look their module up by name.
    sys.modules[_MODULE_NAME] = module
    linecache.checkcache(str(path))
    try:
        with _alarm() as arm:
            arm(_IMPORT_DEADLINE_S)
            exec(code, module.__dict__)
    except (Exception, SystemExit, _DeadlinePassed) as error:
        line = _line_in(str(path), error.__traceback__)
        raise RewardError(
            f"The reward function{_place(path, line)} fails while it is imported: "
            f"{_described(error)}.{_quoted(path, line)}",
            file=path,
            line=line,
            source=_source(path, line),
        ) from error
    return module


def _check_arity(path: Path, function: Callable[..., Any]) -> None:
    try:
        inspect.signature(function).bind({})
    except TypeError as error:
        line = function.__code__.co_firstlineno if inspect.isfunction(function) else None
        raise RewardError(
            f"`{_FUNCTION_NAME}`{_place(path, line)} must take exactly one argument, params."
            f"{_quoted(path, line)}",
            file=path,
            line=line,
            source=_source(path, line),
        ) from error


def _raise_syntax(path: Path, error: SyntaxError | ValueError) -> NoReturn:
    line = error.lineno if isinstance(error, SyntaxError) else None
    what = error.msg if isinstance(error, SyntaxError) else str(error)
    raise RewardError(
        f"The reward function{_place(path, line)} is not valid Python: {what}."
        f"{_quoted(path, line)}",
        file=path,
        line=line,
        source=_source(path, line),
    ) from error


@contextlib.contextmanager
def _alarm() -> Iterator[Callable[[float], None]]:
    """Install the timer once for many calls; yields the function that winds it, 0 stops it."""
    usable = hasattr(signal, "setitimer") and (
        threading.current_thread() is threading.main_thread()
    )
    if not usable:
        yield lambda _: None
        return
    handler_before = signal.signal(signal.SIGALRM, _on_alarm)
    since = time.monotonic()
    left_s, interval_s = signal.setitimer(signal.ITIMER_REAL, 0.0)

    def arm(seconds: float) -> None:
        signal.setitimer(signal.ITIMER_REAL, seconds)

    try:
        yield arm
    finally:
        arm(0.0)
        signal.signal(signal.SIGALRM, handler_before)
        if left_s:  # somebody else's timer ran before: it goes on, less the time we took
            rest_s = max(left_s - (time.monotonic() - since), 1e-3)
            signal.setitimer(signal.ITIMER_REAL, rest_s, interval_s)


def _on_alarm(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise _DeadlinePassed


def _number(value: object) -> float:
    """A float of what a reward function returned. Booleans and integers pass, text does not."""
    if isinstance(value, str | bytes) or not hasattr(value, "__float__"):
        raise _NoRewardError(f"it returned {value!r}, which is not a number")
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise _NoRewardError(f"it returned {value!r}, which is not a number") from error
    if not -REWARD_LIMIT <= number <= REWARD_LIMIT:  # false for NaN as well
        raise _NoRewardError(f"it returned {number}; rewards must lie between -100000 and 100000")
    return number


def _raise_failed(
    function: RewardFunction, params: RewardParams, error: BaseException, deadline_s: float
) -> NoReturn:
    code = getattr(function, "__code__", None)
    path = Path(code.co_filename) if code else None
    line = _line_in(code.co_filename, error.__traceback__) if code else None
    if isinstance(error, _NoRewardError):
        line = code.co_firstlineno if code else None
        what = str(error)
    elif isinstance(error, _DeadlinePassed):
        what = f"it did not return within {deadline_s:g} s, an endless loop?"
    else:
        what = _described(error)
    short = _compact(params)
    raise RewardError(
        f"The reward function{_place(path, line)} failed: {what}.{_quoted(path, line)}\n"
        f"  params = {short}",
        file=path,
        line=line,
        source=_source(path, line),
        params=short,
    ) from (None if isinstance(error, _NoRewardError | _DeadlinePassed) else error)


def _line_in(filename: str, trace: TracebackType | None) -> int | None:
    """The deepest line of the user's file in a traceback: their code, not the library's."""
    lines = [
        line for frame, line in traceback.walk_tb(trace) if frame.f_code.co_filename == filename
    ]
    return lines[-1] if lines else None


def _described(error: BaseException) -> str:
    if isinstance(error, _DeadlinePassed):
        return "it does not end"
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def _place(path: Path | None, line: int | None) -> str:
    if path is None:
        return ""
    return f" in {path}, line {line}," if line else f" in {path}"


def _source(path: Path | None, line: int | None) -> str:
    return linecache.getline(str(path), line).strip() if path and line else ""


def _quoted(path: Path | None, line: int | None) -> str:
    source = _source(path, line)
    return f"\n  {source}" if source else ""


def _compact(params: RewardParams) -> RewardParams:
    """Parameters short enough for a message: the waypoints counted, floats with four decimals."""
    short: RewardParams = {}
    for key, value in params.items():
        if key == "waypoints" and isinstance(value, list):
            short[key] = f"<{len(value)} points>"
        else:
            short[key] = round(value, 4) if isinstance(value, float) else value
    return short

"""The user's reward function: load it, call it with a deadline, name the line that failed."""

import importlib.util
import inspect
import linecache
import math
import os
import sys
from collections.abc import Callable, Iterable
from functools import partial
from itertools import repeat
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any, NoReturn

from drsim.episode.reward_deadline import DeadlinePassed, alarm, end_copy_of
from drsim.episode.reward_errors import (
    code_of,
    compact,
    described,
    line_in,
    place,
    quoted,
    shown,
    source,
)
from drsim.errors import DiscardEpisode, RewardError, RewardErrorKind

RewardParams = dict[str, Any]
RewardFunction = Callable[[RewardParams], float]
OnRewardError = Callable[[int, RewardError], float]
"""Takes the number of a call and its failure; returns the reward instead, or raises the failure."""

REWARD_DEADLINE_S = 5.0
"""How long one call may take. Source: the limit of the console's validator."""

REWARD_LIMIT = 1e5
"""Rewards beyond +-1e5 end the run. Source: the reference simulator."""

_IMPORT_DEADLINE_S = 60.0
"""Importing scientific packages may take seconds; this ends an endless loop in the file."""

_FUNCTION_NAME = "reward_function"
_MODULE_NAME = "_drsim_reward_function"


def load_reward_function(path: Path) -> RewardFunction:
    """Load `reward_function` from a user's file.

    The file becomes a module with a private name; its folder is not added to the import path. Its
    global variables live as long as the process, across episodes. Call the function through
    `checked_reward`.

    Raises:
        RewardError: The file is missing, does not parse, fails while it is imported, or has no
            function `reward_function` that takes one argument and returns a value.
    """
    text = _read(path)
    try:
        code = compile(text, str(path), "exec")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        _raise_syntax(path, error)
    module = _run_module(path, code)
    function = getattr(module, _FUNCTION_NAME, None)
    if not callable(function):
        what = (
            f"{path} defines no function `{_FUNCTION_NAME}`. Add `def {_FUNCTION_NAME}(params):`."
        )
        raise _refused(what, path, None, kind="signature")
    _check_arity(path, function)
    _check_kind(path, function)
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
    on_error: OnRewardError | None = None,
) -> list[float]:
    """Call a reward function once for each car.

    The deadline uses a timer signal, so it exists only in the main thread and only where the system
    has such timers. A function that swallows the exceptions raised at its deadline and goes on for
    seconds ends the process; `sys.excepthook` gets the reason. An operation that Python cannot
    interrupt ends it too, by the signal `reward_deadline.STUCK`.

    `functions` are the user's function, or one for each call; it may keep and alter its parameters.
    One call may take `deadline_s`. The rewards are in the order of the calls. `on_error` decides
    about failures; without it, the first one ends the calls. A call that did not return in time
    always ends them: it was interrupted anywhere, and the next one takes as long.

    Raises:
        RewardError: The function raised, did not return in time, or returned something that is not
            a finite number within +-1e5.
    """
    rewards: list[float] = []
    process = os.getpid()
    each = repeat(functions) if callable(functions) else functions
    with alarm(deadline_s, partial(_end_for, _late(deadline_s))) as clock:
        for params, function in zip(calls, each, strict=False):
            try:
                clock.begin()
                try:
                    value = function(params)
                finally:
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
    return rewards


def as_number(value: object) -> float | None:
    """What a reward function returned as a float; infinite where it is too large for one.

    None for what is not a number: text, complex numbers, arrays of several values. Booleans and
    integers are numbers.
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


class _NoRewardError(Exception):
    """The value returned is not a reward; the text says why."""

    def __init__(self, reason: str, kind: RewardErrorKind) -> None:
        super().__init__(reason)
        self.kind = kind


def _read(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        what = f"The reward function cannot be read: {path} ({error.strerror})."
        raise _refused(what, path, None) from error
    try:
        return data.decode("utf-8-sig")  # editors on Windows begin files with a byte order mark
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        what = f"contains byte 0x{data[error.start]:02x}, which is not UTF-8"
        raise _refused(f"The reward function{place(path, line)} {what}.", path, line) from error


def _run_module(path: Path, code: CodeType) -> ModuleType:
    spec = importlib.util.spec_from_loader(_MODULE_NAME, loader=None, origin=str(path))
    if spec is None:  # never for a spec without a loader, but the signature allows it
        raise _refused(f"{path} cannot become a module.", path, None)
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    # Dataclasses and pickling look their module up by name.
    sys.modules[_MODULE_NAME] = module
    linecache.checkcache(str(path))
    process = os.getpid()
    try:
        with alarm(_IMPORT_DEADLINE_S, partial(_end_for, "its import does not end")) as clock:
            clock.begin()
            try:
                exec(code, module.__dict__)
            finally:
                end_copy_of(process)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        line = line_in(str(path), error.__traceback__)
        what = "it does not end" if isinstance(error, DeadlinePassed) else described(error)
        raise _refused(
            f"The reward function{place(path, line)} fails while it is imported: {what}.",
            path,
            line,
        ) from error
    return module


def _check_arity(path: Path, function: Callable[..., Any]) -> None:
    try:
        inspect.signature(function).bind({})
    except (TypeError, ValueError) as error:  # some functions in C cannot tell
        code = code_of(function)
        line = code.co_firstlineno if code is not None else None
        what = "must take exactly one argument, params"
        refusal = f"`{_FUNCTION_NAME}`{place(path, line)} {what}."
        raise _refused(refusal, path, line, kind="signature") from error


def _check_kind(path: Path, function: Callable[..., Any]) -> None:
    """Refuse a function whose body does not run when it is called."""
    if inspect.iscoroutinefunction(function) or inspect.isasyncgenfunction(function):
        why = "begins with `async`"
    elif inspect.isgeneratorfunction(function):
        why = "contains `yield`"
    else:
        return
    line = function.__code__.co_firstlineno
    raise _refused(
        f"`{_FUNCTION_NAME}`{place(path, line)} {why}, so calling it does not return a number. "
        "Write `def` and `return`.",
        path,
        line,
    )


def _raise_syntax(path: Path, error: Exception) -> NoReturn:
    line = error.lineno if isinstance(error, SyntaxError) else None
    what = error.msg if isinstance(error, SyntaxError) else str(error) or type(error).__name__
    raise _refused(
        f"The reward function{place(path, line)} is not valid Python: {what}.", path, line
    ) from error


def _refused(
    what: str, path: Path, line: int | None, *, kind: RewardErrorKind = "load"
) -> RewardError:
    """A file that cannot be used, with the line in question."""
    return RewardError(
        f"{what}{quoted(path, line)}",
        file=path,
        line=line,
        source=source(path, line),
        kind=kind,
        reason=what.replace(place(path, line), ""),
    )


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


def _end_for(what: str, frame: FrameType | None) -> NoReturn:
    """End this process, whose code at the frame swallows every exception, with a message."""
    while frame is not None and frame.f_globals.get("__name__") != _MODULE_NAME:
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
    """What went wrong in a call, with the exception of the user's code as its cause."""
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
    short = compact(params)
    failure = RewardError(
        f"The reward function{place(path, line)} failed: {what}.{quoted(path, line)}\n"
        f"  params = {short}",
        file=path,
        line=line,
        source=source(path, line),
        params=short,
        kind=kind,
        reason=what,
    )
    failure.__cause__ = None if isinstance(error, _NoRewardError | DeadlinePassed) else error
    return failure

"""Loads a user's reward function from its file, and names the line that is wrong."""

import importlib.util
import inspect
import linecache
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from drsim.episode.reward import (
    USER_MODULE,
    RewardFunction,
    code_of,
    described,
    end_for,
    line_in,
    place,
    quoted,
    source,
)
from drsim.episode.reward_deadline import DeadlinePassed, alarm, end_copy_of
from drsim.errors import RewardError, RewardErrorKind

_IMPORT_DEADLINE_S = 60.0
"""Scientific packages may take seconds; this ends an endless loop."""

_FUNCTION_NAME = "reward_function"


def load_reward_function(path: Path) -> RewardFunction:
    """Load `reward_function` from a user's file, to be called through `checked_rewards`.

    The file becomes a module with a private name; its folder is not added to the import path. Its
    globals live as long as the process.

    Raises:
        RewardError: The file is missing, does not parse, fails while it is imported, or has no
            such function of one argument that returns a value.
    """
    text = _read(path)
    try:
        code = compile(text, str(path), "exec")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = error.lineno if isinstance(error, SyntaxError) else None
        what = error.msg if isinstance(error, SyntaxError) else str(error) or type(error).__name__
        told = f"The reward function{place(path, line)} is not valid Python: {what}."
        raise _refused(told, path, line) from error
    module = _run_module(path, code)
    function = getattr(module, _FUNCTION_NAME, None)
    if not callable(function):
        what = (
            f"The code{place(path, None)} defines no function `{_FUNCTION_NAME}`. "
            f"Add `def {_FUNCTION_NAME}(params):`."
        )
        raise _refused(what, path, None, kind="signature")
    _check_arity(path, function)
    _check_kind(path, function)
    checked: RewardFunction = function
    return checked


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
    spec = importlib.util.spec_from_loader(USER_MODULE, loader=None, origin=str(path))
    if spec is None:  # never for a spec without a loader, but the signature allows it
        raise _refused(f"{path} cannot become a module.", path, None)
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    # Dataclasses and pickling look their module up by name.
    sys.modules[USER_MODULE] = module
    linecache.checkcache(str(path))
    process = os.getpid()
    try:
        with alarm(_IMPORT_DEADLINE_S, partial(end_for, "its import does not end")) as clock:
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


def _refused(
    what: str, path: Path, line: int | None, *, kind: RewardErrorKind = "load"
) -> RewardError:
    return RewardError(
        f"{what}{quoted(path, line)}",
        file=path,
        line=line,
        source=source(path, line),
        kind=kind,
        reason=what.replace(place(path, line), ""),
    )

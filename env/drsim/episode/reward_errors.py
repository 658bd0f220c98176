"""Error texts for a user's code: file, line, exception, returned value."""

import ast
import inspect
import linecache
import traceback
import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from types import CodeType, TracebackType
from typing import Any

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

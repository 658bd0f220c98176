"""How this package compiles its kernels with numba."""

import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])

_numba_config: Any = numba.config  # numba sets its names at run time
_insert_function: Any = cgutils.get_or_insert_function


def kernel(function: F) -> F:
    """Compile a function of numbers and arrays to machine code that runs without the GIL.

    The machine code is cached, so that only the first run compiles: in NUMBA_CACHE_DIR, else beside
    the module, else in the user's home, else in a private folder below the temporary one. If none
    of them can be written, every process compiles.

    A cached kernel is compiled again when its own file changes, not when a kernel in another file
    does. So a kernel uses kernels, records and constants of its own file only; numbers of other
    files are arguments.

    A named tuple costs a call about a microsecond more than a plain one. So Python mostly hands
    over plain tuples, whose parts the kernel names, and gets plain tuples back.
    """
    try:
        if not _numba_config.CACHE_DIR and _home_is_unknown():
            _use_temporary_folder()
        return _compiled(function, cache=True)
    except RuntimeError:  # numba found no place for a cache
        pass
    try:
        _use_temporary_folder()
        return _compiled(function, cache=True)
    except (OSError, RuntimeError):
        return _compiled(function, cache=False)


def _prefetch(_context: Any, array: Any, index: Any) -> tuple[Any, Callable[..., Any]]:
    """The type of a call, and what writes its machine code."""

    def instruction(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = context.make_array(signature.args[0])(context, builder, arguments[0])
        step = builder.extract_value(values.strides, 0)
        word, number = ir.IntType(64), ir.IntType(32)
        place = builder.mul(builder.zext(arguments[1], word), step)
        address = builder.add(builder.ptrtoint(values.data, word), place)
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = _insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        # To read, to be kept in all caches, data rather than instructions.
        builder.call(function, [builder.inttoptr(address, byte), number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, index), instruction


def _take_number(_context: Any, counter: Any) -> tuple[Any, Callable[..., Any]]:
    """The type of a call, and what writes its machine code."""

    def instruction(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        count = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("add", count, count.type.pointee(1), "monotonic")

    return counter.dtype(counter), instruction


prefetch: Any = intrinsic(_prefetch)
"""For kernels: `prefetch(array, index)` asks the memory for an element, and goes on without it.

The array has one dimension; the index is unsigned and lies within it.
"""

take_number: Any = intrinsic(_take_number)
"""For kernels: `take_number(counter)` returns the first integer of an array and adds 1 to it.

Threads that take numbers from one counter at the same time all get different ones.
"""


def _compiled(function: F, *, cache: bool) -> F:
    return cast(F, numba.njit(cache=cache, nogil=True, fastmath=False)(function))


def _home_is_unknown() -> bool:
    """Whether numba would make a folder named `~` in the current one."""
    try:
        Path.home()
    except RuntimeError:
        return "XDG_CACHE_HOME" not in os.environ
    return False


def _use_temporary_folder() -> None:
    """Let numba cache below the temporary folder, if nobody else can put code there.

    Raises:
        OSError: The folder cannot be made, or others can write to it.
    """
    folder = Path(tempfile.gettempdir()) / f"drsim-kernels-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    others_write = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or others_write:
        raise PermissionError(f"{folder} is not this user's own")
    _numba_config.CACHE_DIR = str(folder)

"""How this package compiles its kernels with numba."""

import os
import stat
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba.core import cgutils, registry, types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])

_numba_config: Any = numba.config  # numba sets its names at run time
_cpu: Any = registry.cpu_target
_insert_function: Any = cgutils.get_or_insert_function


def kernel(function: F) -> F:
    """Compile a function of numbers and arrays to machine code that runs without the GIL.

    Cached in NUMBA_CACHE_DIR, else beside the module, in the user's home or a private temporary
    folder.

    Only a change of a kernel's own file compiles it again, so it uses kernels, records and
    constants of that file only. A named tuple costs a microsecond more per call than a plain one.
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


def _load_array_functions() -> None:
    """Numba loads scipy's algebra, which takes 0.25 s, only to know whether it is there: it is."""
    algebra, modules = "scipy.linalg.cython_blas", cast(dict[str, Any], sys.modules)
    if algebra in modules:
        return
    modules[algebra] = None  # as if it was not installed
    try:
        functions: Any = import_module("numba.np.arraymath")
    finally:
        del modules[algebra]
    functions._HAVE_BLAS = True


def get_ready() -> None:
    """Load all of numba, as the first call of a kernel does otherwise, which takes 0.4 s."""
    _cpu.typing_context.refresh()
    _cpu.target_context.refresh()


def _prefetch(_context: Any, array: Any, index: Any) -> tuple[Any, Callable[..., Any]]:
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
    def instruction(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        count = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("add", count, count.type.pointee(1), "monotonic")

    return counter.dtype(counter), instruction


prefetch: Any = intrinsic(_prefetch)
"""`prefetch(array, index)` asks the memory for an element. The index is unsigned."""

take_number: Any = intrinsic(_take_number)
"""`take_number(counter)` returns the first integer of an array and adds 1 to it, across threads."""


def _compiled(function: F, *, cache: bool) -> F:
    return cast(F, numba.njit(cache=cache, nogil=True, fastmath=False)(function))


def _home_is_unknown() -> bool:
    """Whether numba would make a folder named `~`."""
    try:
        Path.home()
    except RuntimeError:
        return "XDG_CACHE_HOME" not in os.environ
    return False


def _use_temporary_folder() -> None:
    """Cache below the temporary folder, if nobody else can put code there, else OSError."""
    folder = Path(tempfile.gettempdir()) / f"drsim-kernels-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    others_write = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or others_write:
        raise PermissionError(f"{folder} is not this user's own")
    _numba_config.CACHE_DIR = str(folder)


_load_array_functions()

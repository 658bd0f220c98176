"""The one way this package compiles its hot loops with numba."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a function of numbers and arrays to machine code that runs without the GIL.

    The compiled code is cached beside the module, so that only the first run on a machine pays
    for the compilation.
    """
    return cast(F, numba.njit(cache=True, nogil=True, fastmath=False)(function))

"""Libraries that only some users need, loaded when they are needed."""

import importlib
import importlib.util
from functools import cache
from typing import Any

from drcli.base.errors import NotAvailable
from drcli.base.installation import import_error

_INSTALL = {
    "onnx": 'pip install "drcli[onnx]"',
    "onnxruntime": 'pip install "drcli[onnx]"',
    "openvino": 'pip install "drcli[openvino]"',
    "ai_edge_litert": 'pip install "drcli[tflite]"',
    "tensorflow": "pip install tensorflow-cpu",
}
"""How each library is installed."""


def library(name: str, module: str = "") -> Any:
    """A library, or one of its modules.

    Raises:
        NotAvailable: It is not installed, or cannot be loaded here.
    """
    require(name)
    try:
        return importlib.import_module(module or name)
    except (ImportError, OSError) as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        raise import_error(error) or NotAvailable(
            f"The package {name} is installed but cannot be loaded: {reason}",
            remedy=f"Install it again with `{_INSTALL[name]}`.",
        ) from None


def openvino_core() -> Any:
    """The OpenVINO of this process; there is one, and it stays.

    On processors with AMX, each core gives the thread another stack for signals and takes it back
    when it is freed. After several cores, the thread is left with one that is freed, and the next
    signal kills the process.

    Raises:
        NotAvailable: OpenVINO is not installed.
    """
    return _only_core(library("openvino"))


@cache
def _only_core(openvino: Any) -> Any:
    return openvino.Core()


def require(*names: str) -> None:
    """Check that one of these libraries is installed, without loading it.

    Raises:
        NotAvailable: None of them is.
    """
    if not any(map(is_installed, names)):
        raise NotAvailable(
            f"This needs the package {names[0]}, which is not installed.",
            remedy=f"Install it with `{_INSTALL[names[0]]}`.",
        )


def is_installed(name: str) -> bool:
    """Whether a library is installed."""
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False

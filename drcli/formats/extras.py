"""Optional libraries, loaded when needed."""

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


def library(name: str, module: str = "") -> Any:
    """NotAvailable if it cannot be loaded."""
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
    """The one OpenVINO of this process.

    With AMX, each core gives the thread another stack for signals and takes it back when freed.
    After several, the thread keeps a freed one, and the next signal kills the process.
    """
    return _only_core(library("openvino"))


@cache
def _only_core(openvino: Any) -> Any:
    return openvino.Core()


def require(*names: str) -> None:
    """NotAvailable if none is installed; loads nothing."""
    if not any(map(is_installed, names)):
        raise NotAvailable(
            f"This needs the package {names[0]}, which is not installed.",
            remedy=f"Install it with `{_INSTALL[names[0]]}`.",
        )


def is_installed(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):
        return False

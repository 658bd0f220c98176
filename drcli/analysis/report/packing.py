"""Numbers for the page: short lists as JSON, long ones as base64."""

import base64
import json
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_SHORT = 64
_INTEGERS: dict[str, tuple[type[np.signedinteger[Any]], int]] = {
    "i8": (np.int8, 127),
    "i16": (np.int16, 32767),
}
"""Types and greatest values; one below the negative is NaN."""


def numbers(values: ArrayLike) -> object:
    """Values as a list, {"f32": base64} or what `quantised` returns."""
    array = np.asarray(values, dtype=np.float64)
    if len(array) <= _SHORT:
        return [float(f"{value:.6g}") if math.isfinite(value) else None for value in array.tolist()]
    if np.isfinite(array).all() and (array == np.rint(array)).all():
        for kind, (_, most) in _INTEGERS.items():
            if np.abs(array).max() <= most:
                return quantised(array, kind, low=-most, high=most)
    limit = float(np.finfo(np.float32).max)
    small = np.where(np.isfinite(array) & (np.abs(array) <= limit), array, np.nan)
    return {"f32": _base64(small.astype("<f4"))}


def quantised(values: ArrayLike, kind: str, *, low: float, high: float) -> object:
    """Integers of kind "i8" or "i16", cut to the limits; NaN stays NaN.

    Returns:
        {kind: base64, "middle": value of 0, "step": difference between two neighbours}.
    """
    array = np.asarray(values, dtype=np.float64)
    number, most = _INTEGERS[kind]
    middle = (low + high) / 2
    step = (high - low) / (2 * most) or 1.0
    integers = np.clip(np.rint((array - middle) / step), -most, most)
    integers = np.where(np.isnan(integers), -most - 1, integers)
    data = integers.astype(np.dtype(number).newbyteorder("<"))
    return {kind: _base64(data), "middle": middle, "step": step}


def json_text(value: object) -> str:
    """JSON that cannot end a script element."""
    text = json.dumps(_finite(value), separators=(",", ":"))
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")


def _finite(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return value

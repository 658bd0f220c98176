"""Weights in half precision, as the ready-made models are shipped."""

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from drcli.base.errors import SettingsError

LARGE = 256
"""Numbers of a tensor that is rounded. Smaller ones, such as biases, stay exact."""


def halved(tensors: bytes) -> bytes:
    """A safetensors file with its large float32 tensors in float16."""
    found = load(tensors)
    return save(
        {
            name: array.astype(np.float16)
            if array.dtype == np.float32 and array.size >= LARGE
            else array
            for name, array in found.items()
        }
    )


def restored(data: bytes, origin: str) -> bytes:
    """The same in float32 again, which loses nothing; SettingsError if damaged."""
    try:
        found = load(data)
    except SafetensorError as error:
        raise SettingsError(
            f"{origin} is damaged: {error}.",
            remedy="Install drcli again, or get that file again with `git checkout`.",
        ) from error
    return save(
        {
            name: array.astype(np.float32) if array.dtype == np.float16 else array
            for name, array in found.items()
        }
    )

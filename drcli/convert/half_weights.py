"""Weights in half precision, as the ready-made models are shipped."""

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from drcli.base.errors import SettingsError

LARGE = 256
"""Smaller tensors, such as biases, stay exact."""


def halved(tensors: bytes) -> bytes:
    """Large float32 tensors become float16."""
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
    """Back to float32, which loses nothing; SettingsError if damaged."""
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

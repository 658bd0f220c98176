"""Weights in half precision, as the ready-made models are shipped: half the size."""

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from drcli.base.errors import SettingsError

LARGE = 256
"""Numbers from which on a tensor is rounded. Smaller ones, such as biases and the critic's unit,
take no room and stay exact."""


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
    """The same weights as a checkpoint has them: float16 becomes float32, which loses nothing.

    Raises:
        SettingsError: The file is damaged; `origin` is what the message calls it.
    """
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

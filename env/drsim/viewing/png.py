"""Pictures as PNG files, without a picture library."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOR_TYPES = {1: 0, 3: 2}
"""Numbers of the PNG format for grey and for red, green and blue."""


def png_bytes(picture: NDArray[np.uint8]) -> bytes:
    """A picture as the content of a PNG file.

    Args:
        picture: Grey, shape (rows, columns), or RGB, shape (rows, columns, 3).

    Raises:
        ValueError: It has another shape.
    """
    channels = 1 if picture.ndim == 2 else picture.shape[-1]
    if picture.ndim not in (2, 3) or channels not in _COLOR_TYPES or not picture.size:
        raise ValueError(f"A picture of shape {picture.shape} is neither grey nor RGB.")
    rows, columns = picture.shape[:2]
    lines = np.zeros((rows, 1 + columns * channels), np.uint8)  # each begins with its filter: none
    lines[:, 1:] = picture.reshape(rows, -1)
    header = struct.pack(">IIBBBBB", columns, rows, 8, _COLOR_TYPES[channels], 0, 0, 0)
    return (
        _SIGNATURE
        + _chunk(b"IHDR", header)
        + _chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
        + _chunk(b"IEND", b"")
    )


def _chunk(kind: bytes, content: bytes) -> bytes:
    check = zlib.crc32(kind + content)
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

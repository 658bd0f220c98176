"""Recognises Python pickles; loading one may run any program."""

import pickletools
import re
import zipfile
from io import BytesIO
from itertools import islice

_WEIGHT_FILE = re.compile(
    r"\.(pb|index|meta|safetensors|onnx|tflite|bin|xml|pt|pth|pkl|pickle|npy|npz|ckpt|h5|zip)$"
    r"|\.data-\d+-of-\d+$",
    re.IGNORECASE,
)

_CERTAIN_AFTER = 200
"""Other data does not have so many operations in a row."""

_PICKLE_IN_ZIP = re.compile(r"(^|/)[^/]*\.(pkl|pickle)$|(^|/)data$", re.IGNORECASE)


def is_weight_file(name: str) -> bool:
    return _WEIGHT_FILE.search(name) is not None


def is_pickle(data: bytes) -> bool:
    """Also a file of PyTorch or NumPy that contains one."""
    if data.startswith(b"PK\x03\x04"):
        try:
            with zipfile.ZipFile(BytesIO(data)) as archive:
                return any(map(_PICKLE_IN_ZIP.search, archive.namelist()))
        except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, OSError):
            return False
    if data.startswith(b"\x93NUMPY"):
        return b"'O'" in data[:256] or b"|O" in data[:256]
    return _has_operations(data)


def _has_operations(data: bytes) -> bool:
    stream = BytesIO(data)
    count = 0
    name = ""
    try:
        for operation, _, _ in islice(pickletools.genops(stream), _CERTAIN_AFTER):
            count += 1
            name = operation.name
    except (ValueError, EOFError, UnicodeDecodeError, OverflowError, MemoryError):
        return False
    if name == "STOP":
        return count > 1 and not data[stream.tell() :].strip(b"\0\r\n ")
    return count == _CERTAIN_AFTER

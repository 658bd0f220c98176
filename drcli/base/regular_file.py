"""Reads only files that never make a reader wait."""

import errno
import os
import stat
from pathlib import Path


def read_regular(path: Path, limit: int = -1) -> bytes:
    """At most `limit` bytes.

    Raises:
        OSError: It cannot be read, or is not a file.
    """
    # Without waiting, because what lies at the path is only known when it is open.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb", closefd=True) as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "It is not an ordinary file", str(path))
        return file.read(limit)

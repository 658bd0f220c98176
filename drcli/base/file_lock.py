"""A lock between processes of one machine that the system releases when its holder dies."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drcli.base.backoff import wait_until
from drcli.base.errors import StorageError


@contextmanager
def exclusive(path: Path, *, patience_s: float) -> Iterator[None]:
    """Hold a lock file.

    The file stays behind; it is the hold on it that counts, and no crash can leave that behind.

    Args:
        path: Lock file, made when missing.
        patience_s: How long to wait for another holder.

    Raises:
        StorageError: Somebody else held it for so long.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        if not wait_until(
            lambda: _take(descriptor),
            patience_s=patience_s,
            last_s=0.2,
            what=f"Waiting for another command that is busy with the local server ({path}) ...",
        ):
            raise StorageError(
                f"Another command has been busy with the local server for {patience_s:.0f} s "
                f"({path}).",
                remedy="Wait for it, or end it, and start this command again.",
            )
        yield
    finally:
        os.close(descriptor)


def _take(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True

"""Rewrites a racer's own file: one command at a time, whole or not at all, mode and owner kept."""

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drcli.errors import SettingsError

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def only_writer(directory: Path) -> Iterator[None]:
    """Wait until no other command rewrites files of this folder, and keep others out meanwhile.

    The folder itself is what is locked, so nothing is left behind, whatever happens.

    Args:
        directory: The racer's working folder.

    Raises:
        SettingsError: There is no such folder, or it may not be read.
    """
    try:
        descriptor = os.open(directory, os.O_RDONLY)
    except OSError as e:
        raise SettingsError(
            f"{directory}: cannot be read ({e.strerror or e}).",
            remedy="Change to the folder that holds run.env.",
        ) from e
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def rewrite(path: Path, data: bytes) -> None:
    """Give a file another content in one step; a reader meets the old one or the new one.

    Args:
        path: The file, or a link to it. It need not exist.
        data: The new content.

    Raises:
        SettingsError: It cannot be written; it is as it was.
    """
    target = Path(os.path.realpath(path))  # a link in a circle stands for itself
    scratch = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        if target.exists():
            if not target.is_file():  # /dev/null, put there to silence it, must stay what it is
                raise OSError(0, "it is no ordinary file")
            if not os.access(target, os.W_OK):
                raise PermissionError(0, "it is write-protected")
            shutil.copy2(target, scratch)
            with suppress(PermissionError):  # only root can give a file to somebody else
                shutil.chown(scratch, target.stat().st_uid, target.stat().st_gid)
        with scratch.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(target)
    except OSError as e:
        with suppress(OSError):
            scratch.unlink()
        raise SettingsError(
            f"{path}: cannot be written ({e.strerror or e}).",
            remedy=remedy_for(e, path, f"Check that you may write {path} and its folder."),
        ) from e


def remedy_for(error: OSError, path: Path, otherwise: str) -> str:
    """What to do about a file or folder that cannot be written.

    Args:
        error: Why it cannot.
        path: The file or folder.
        otherwise: What to do where its disk has room.
    """
    if error.errno in _NO_ROOM:
        return f"Make room on the disk that holds {path}, and run the command again."
    return otherwise

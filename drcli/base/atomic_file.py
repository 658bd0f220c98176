"""Writes files whole or not at all: a racer's own, one command at a time, and notes of ours."""

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from drcli.base import notices
from drcli.base.backoff import wait_until
from drcli.base.errors import SettingsError
from drcli.base.json_record import Misfit, parsed

PATIENCE_S = 30.0
"""How long to wait for another command; each needs the folder for a moment only."""

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def only_writer(directory: Path) -> Iterator[None]:
    """Wait until no other command rewrites files of this folder, and keep others out meanwhile.

    The folder itself is what is locked, so nothing is left behind, whatever happens.

    Args:
        directory: The racer's working folder.

    Raises:
        SettingsError: There is no such folder, it may not be read, or another command kept it for
            `PATIENCE_S`.
    """
    try:
        descriptor = os.open(directory, os.O_RDONLY)
    except OSError as e:
        raise SettingsError(
            f"{directory}: cannot be read ({e.strerror or e}).",
            remedy="Change to the folder that holds run.env.",
        ) from e
    try:
        _take(descriptor, directory)
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
        _fill_and_move(scratch, target, data)
    except OSError as e:
        with suppress(OSError):
            scratch.unlink()
        raise SettingsError(
            f"{path}: cannot be written ({e.strerror or e}).",
            remedy=remedy_for(e, path, f"Check that you may write {path} and its folder."),
        ) from e


def write_json(path: Path, value: object) -> None:
    """Write a note of ours in one step; its folder is made where it is missing.

    Raises:
        OSError: It cannot be written; it is as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        _fill_and_move(scratch, path, json.dumps(value, indent=2).encode())
    except OSError:
        with suppress(OSError):
            scratch.unlink()
        raise


def read_json(path: Path) -> Any:
    """A note of ours, None where there is none or nothing can be made of it.

    A disk that was full, or a machine that lost its power, may leave anything behind.
    """
    try:
        return parsed(path.read_bytes())
    except (OSError, Misfit):
        return None


def _take(descriptor: int, directory: Path) -> None:
    """Lock the folder; whoever has to wait for that is told."""
    if _lock(descriptor):
        return
    notices.show(f"Waiting for another command that is busy with {directory} ...")
    if not wait_until(lambda: _lock(descriptor), patience_s=PATIENCE_S, first_s=0.01, last_s=0.2):
        raise SettingsError(
            f"{directory}: another command has been busy with this folder for {PATIENCE_S:.0f} s.",
            remedy="Wait until it has ended, or end it, and run this command again.",
        )


def _lock(descriptor: int) -> bool:
    """Whether the lock was to be had at once."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _fill_and_move(scratch: Path, target: Path, data: bytes) -> None:
    """Write beside the target, and take its place once all of it is on the disk."""
    with scratch.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    scratch.replace(target)


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

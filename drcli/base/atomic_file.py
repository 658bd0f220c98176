"""Writes files completely or not at all."""

import errno
import json
import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

from drcli.base.errors import SettingsError
from drcli.base.json_record import Misfit, parsed

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


def rewrite(path: Path, data: bytes) -> None:
    """Replace the content of a racer's file in one step: a reader sees the old or the new one.

    Args:
        path: The file, or a link to it. It need not exist.
        data: The new content.

    Raises:
        SettingsError: It cannot be written, and has not changed.
    """
    target = Path(os.path.realpath(path))  # a link in a circle stands for itself
    scratch = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        if target.exists():
            if not target.is_file():  # a link to /dev/null must stay one
                raise OSError(0, "it is not an ordinary file")
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
    """Write a record of ours in one step. Its folder is made where it is missing.

    Raises:
        OSError: It cannot be written, and has not changed.
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
    """A record of ours; None where the file does not exist or is damaged.

    A full disk or a power failure may leave anything behind.
    """
    try:
        return parsed(path.read_bytes())
    except (OSError, Misfit):
        return None


def _fill_and_move(scratch: Path, target: Path, data: bytes) -> None:
    """Write beside the target, and take its place once all of it is on the disk."""
    with scratch.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    scratch.replace(target)


def remedy_for(error: OSError, path: Path, otherwise: str) -> str:
    """What to do about a file or folder that cannot be written; `otherwise` where there is room."""
    if error.errno in _NO_ROOM:
        return f"Make room on the disk that holds {path}, and run the command again."
    return otherwise

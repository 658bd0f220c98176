"""Writes files completely or not at all; our own records even on a full disk."""

import json
import os
import shutil
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from drcli.base.errors import SettingsError
from drcli.base.json_record import RecordError, from_json, parse_json
from drcli.base.private_files import hand_out, is_settings
from drcli.base.regular_file import read_regular
from drcli.base.system_calls import flush_descriptor, flush_to_disk, is_disk_full

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")

_RESERVED_BYTES = 4096
_STAT_BLOCK_BYTES = 512


def rewrite(path: Path, data: bytes) -> None:
    """Replace a racer's file, or the one that a link leads to.

    It keeps its mode and, if possible, its owner. A new one is handed out, unless it has settings,
    which may be secrets.

    Raises:
        SettingsError: The file cannot be written, and has not changed.
    """
    target = Path(os.path.realpath(path))  # a link in a circle stands for itself
    try:
        if target.exists():
            if not target.is_file():  # a link to /dev/null must stay one
                raise OSError(0, "it is not an ordinary file")
            if not os.access(target, os.W_OK):
                raise PermissionError(0, "it is write-protected")
        _replace(target, data, is_racers=True)
    except OSError as e:
        raise SettingsError(
            f"{path}: cannot be written ({e.strerror or e}).",
            remedy=remedy_for(e, path, f"Check that you can write {path} and its folder."),
        ) from e


def write_json(path: Path, value: object) -> None:
    """Write JSON for ourselves, with its folder.

    Raises:
        OSError: The file cannot be written, and has not changed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _replace(path, json.dumps(value, indent=2).encode())


def reserve(path: Path) -> None:
    """Make an empty record that has room even when the disk is full."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _overwrite(path, b" " * _RESERVED_BYTES)


def write_private(path: Path, data: bytes) -> None:
    """Write a file that only this user may read, in a folder that only this user may enter.

    Raises:
        OSError: The file cannot be written, and has not changed.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    _replace(path, data, private=True)


def write_private_json(path: Path, value: object) -> None:
    write_private(path, json.dumps(value, indent=2).encode())


def read_json(path: Path) -> Any:
    """None if missing or damaged, as by a power failure."""
    try:
        return parse_json(read_regular(path))
    except (OSError, RecordError):
        return None


def save_record(path: Path, record: "DataclassInstance") -> None:
    """Write a record as with `write_json`; on a full disk, over the old one, which has room.

    How a training ended is worth more than that nobody reads half of it.
    """
    value = asdict(record)
    try:
        write_json(path, value)
    except OSError as error:
        data = json.dumps(value).encode()
        if not is_disk_full(error) or not _has_room(path, len(data)):
            raise
        _overwrite(path, data)


def load_record(kind: type[T], path: Path) -> T | None:
    """None if missing or damaged."""
    try:
        return from_json(kind, read_json(path))
    except RecordError:
        return None


def _replace(target: Path, data: bytes, *, is_racers: bool = False, private: bool = False) -> None:
    """Write a second file, then rename it: a reader sees the old content or the new one.

    With `private`, and at first for a racer's file, only this user can read it.
    """
    scratch = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        if private or is_racers:
            scratch.unlink(missing_ok=True)
            os.close(os.open(scratch, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
        if is_racers and target.exists():
            with suppress(PermissionError):  # only root can change the owner
                shutil.chown(scratch, target.stat().st_uid, target.stat().st_gid)
            shutil.copystat(target, scratch)
        elif is_racers and not is_settings(target):
            hand_out(scratch)
        with scratch.open("wb") as file:
            file.write(data)
            file.flush()
            flush_descriptor(file.fileno())
        scratch.replace(target)
        with suppress(OSError):  # a reader sees the new content already
            flush_to_disk(target.parent)
    except OSError:
        with suppress(OSError):
            scratch.unlink()
        raise


def _has_room(path: Path, size_bytes: int) -> bool:
    return path.is_file() and path.stat().st_blocks * _STAT_BLOCK_BYTES >= size_bytes


def _overwrite(path: Path, data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        size = os.fstat(descriptor).st_size
        os.pwrite(descriptor, data.ljust(size), 0)
        flush_descriptor(descriptor)
    finally:
        os.close(descriptor)


def remedy_for(error: OSError, path: Path, otherwise: str) -> str:
    """What to do if a file cannot be written; `otherwise` unless the disk is full."""
    if is_disk_full(error):
        return f"Make room on the disk that holds {path}, and run the command again."
    return otherwise

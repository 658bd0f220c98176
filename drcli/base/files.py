"""Writes files completely or not at all; our own records even on a full disk."""

import codecs
import errno
import glob
import json
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from drcli.base.clock import wait_until
from drcli.base.errors import DrError, Problem, ProblemsError, SettingsError, StorageError
from drcli.base.json_record import RecordError, decode_json
from drcli.base.system_calls import flush_descriptor, flush_to_disk, is_disk_full, try_lock

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

# Who may read what drcli writes.
#
# There may be secrets, so everything is for its user alone, but files that a racer asks for get
# the racer's own umask (`hand_out`).


_SETTINGS = re.compile(r".*\.env(\.bak\d*)?")
_racers: int | None = None
"""While the process has another."""


@contextmanager
def private(shared: Path) -> Iterator[None]:
    """Create files for this user alone, also in started processes.

    A group keeps its rights if `shared` has the setgid bit.
    """
    global _racers
    try:
        mode = shared.stat().st_mode
    except OSError:
        mode = 0
    for_group = mode & 0o070 if mode & stat.S_ISGID else 0
    outer, before = _racers, os.umask(0o077 & ~for_group)
    _racers = before
    try:
        yield
    finally:
        os.umask(before)
        _racers = outer


def hand_out(path: Path) -> None:
    """Give a new file the rights of the racer's umask.

    Nobody gets rights who cannot enter its folder. Settings stay private.
    """
    given = 0o777 if path.is_dir() else 0o666
    enters = 7 * (path.parent.stat().st_mode & 0o111)
    path.chmod(given & ~_racers_umask() & enters)


def is_settings(path: Path) -> bool:
    return _SETTINGS.fullmatch(path.name) is not None


def make_folder(path: Path) -> None:
    """Handed out, like those above it."""
    if not path.parent.exists():
        make_folder(path.parent)
    if not path.is_dir():
        path.mkdir(exist_ok=True)
        hand_out(path)


def others_may_read(path: Path) -> bool:
    mode = path.stat().st_mode
    folder = path if path.is_dir() else path.parent
    is_meant = folder.stat().st_mode & stat.S_ISGID
    return bool(mode & (0o004 if is_meant else 0o044))


def _racers_umask() -> int:
    if _racers is not None:
        return _racers
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


# Reads only files that never make a reader wait.


def read_regular(path: Path) -> bytes:
    """OSError if it cannot be read, or is not a file."""
    # Without waiting, because what lies at the path is only known when it is open.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb", closefd=True) as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "It is not an ordinary file", str(path))
        return file.read()


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


def read_json(path: Path) -> dict[str, Any] | None:
    """None if missing or damaged, as by a power failure."""
    return load_record(dict[str, Any], path)


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
        return decode_json(kind, read_regular(path))
    except (OSError, RecordError):
        return None


class FileRecord:
    """A dataclass in a file of its own."""

    FILE: ClassVar[str]

    def write(self, folder: Path) -> None:
        """Raises OSError."""
        record: Any = self
        save_record(folder / self.FILE, record)

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """None if missing or unreadable."""
        return load_record(cls, folder / cls.FILE)


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


# Files that commands write, and never replace.


_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


def safe_name(text: str) -> str:
    """A prefix as a file name.

    `anna/m1` and `ben/m1` differ.
    """
    return _UNSAFE.sub("-", text).strip("-.") or "model"


def without_dots(path: Path) -> Path:
    """Without `..`, which a person would have to work out; a link before it is followed."""
    return path.resolve() if ".." in path.parts else path


def find_files(folder: Path, pattern: str) -> Iterator[Path]:
    """As `Path.glob`, without `**`; that fails if a folder is removed meanwhile (Python < 3.13)."""
    for name in glob.iglob(pattern, root_dir=folder, include_hidden=True):  # noqa: PTH207
        yield folder / name


def refuse_existing(path: Path, *, force: bool) -> None:
    """SettingsError, unless `force` (-f)."""
    try:
        exists, is_file, is_folder = path.exists(), path.is_file(), path.is_dir()
    except OSError as error:
        raise _unwritable(path, error.strerror or str(error)) from None
    if is_folder:
        raise _unwritable(path, "it is a folder")
    if exists and not is_file:
        raise _unwritable(path, "it is not an ordinary file")
    if exists and not force:
        raise SettingsError(
            f"{path} exists already, and is not replaced.",
            remedy="Name another file, or replace it with -f (--force).",
        )


def refuse_replacing(path: Path, *, force: bool) -> None:
    """Also where no file can be made."""
    if not path.parent.is_dir():
        raise _unwritable(path, f"the folder {path.parent} does not exist")
    refuse_existing(path, force=force)
    refuse_new_file(path)


def make_picture_folder(folder: Path) -> None:
    try:
        make_folder(folder)
    except OSError as error:
        raise SettingsError(
            f"{folder} cannot be made ({error.strerror or error}).",
            remedy="Name a folder that you can write to, such as --png pictures.",
        ) from None


def refuse_new_file(path: Path) -> None:
    """SettingsError where no file can be made."""
    try:
        with tempfile.NamedTemporaryFile(prefix=f".{path.name}.", suffix=".part", dir=path.parent):
            pass
    except OSError as error:
        raise _unwritable(path, error.strerror or str(error)) from None


def _unwritable(path: Path, reason: str) -> SettingsError:
    return SettingsError(
        f"{path} cannot be written: {reason}.",
        remedy="Choose a file in a folder that exists and that you can write to.",
    )


# Decodes files that people edit: UTF-8, with or without a byte order mark.


def decode(data: bytes, name: str, rule: str, *, largest_bytes: int, remedy: str) -> str:
    """ProblemsError if it is too large, or not UTF-8."""
    if len(data) > largest_bytes:
        size = f"{len(data):,} bytes long; at most {largest_bytes:,} are allowed."
        what = f"The file is {size}"
        raise ProblemsError([Problem(rule, "error", name, None, what, remedy)])
    zeros = [not byte for byte in data[:16]]  # every other one in Latin letters
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or (
        len(zeros) > 1 and zeros in ([n % 2 == k for n in range(len(zeros))] for k in (0, 1))
    ):
        what = "The file is UTF-16 text, as PowerShell writes it, and not UTF-8."
        how = f"Save it as UTF-8, as with `iconv -f UTF-16 -t UTF-8 {PurePosixPath(name).name}`."
        raise ProblemsError([Problem(rule, "error", name, None, what, how)])
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = data[: e.start].count(b"\n") + 1
        what = f"Byte 0x{data[e.start]:02x} is not UTF-8 text."
        raise ProblemsError([Problem(rule, "error", name, line, what, remedy)]) from e


# Files that programs leave behind.


_NAMES = frozenset(
    {
        *(".ds_store", "__macosx", ".appledouble", ".spotlight-v100", ".trashes", ".fseventsd"),
        *("thumbs.db", "ehthumbs.db", "desktop.ini", "$recycle.bin", ".directory", "@eadir"),
        *("__pycache__", ".git", ".ipynb_checkpoints"),
    }
)
_BEGINNINGS = ("._", ".nfs", ".~lock.", "~$")


def is_left_behind(name: str) -> bool:
    return any(
        part.casefold() in _NAMES or part.startswith(_BEGINNINGS)
        for part in PurePosixPath(name).parts
    )


# Locks between processes, which the system releases at their end.


PATIENCE_S = 30.0


@contextmanager
def exclusive(
    path: Path,
    *,
    patience_s: float,
    what: str = "the local S3 server",
    failure: type[DrError] = StorageError,
) -> Iterator[None]:
    """Hold a lock file, which is created if needed and never deleted.

    Raises:
        StorageError: Another command held it for `patience_s`; or another `failure`.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    with _held(descriptor, f"{what} ({path})", patience_s, failure):
        yield


@contextmanager
def only_writer(directory: Path) -> Iterator[None]:
    """Lock a working folder against other commands.

    Raises:
        SettingsError: It is unreadable, or was in use for `PATIENCE_S`.
    """
    try:
        descriptor = os.open(directory, os.O_RDONLY)
    except OSError as e:
        raise SettingsError(
            f"{directory}: cannot be read ({e.strerror or e}).",
            remedy="Change to the folder that holds run.env.",
        ) from e
    with _held(descriptor, f"the folder {directory}", PATIENCE_S, SettingsError):
        yield


@contextmanager
def _held(descriptor: int, what: str, patience_s: float, failure: type[DrError]) -> Iterator[None]:
    try:
        if not wait_until(
            lambda: try_lock(descriptor),
            patience_s=patience_s,
            first_s=0.01,
            last_s=0.2,
            what=f"Waiting for another command that is using {what} ...",
        ):
            raise failure(
                f"Another command has been using {what} for {patience_s:.0f} s.",
                remedy="Wait until it has ended, or end it, and run this command again.",
            )
        yield
    finally:
        os.close(descriptor)


def leads_to(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError:
        return False

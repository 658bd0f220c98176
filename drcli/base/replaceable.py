"""Files that commands write, and never replace."""

import re
import tempfile
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.private_files import make_folder

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


def safe_name(text: str) -> str:
    """A prefix as a file name.

    `anna/m1` and `ben/m1` differ.
    """
    return _UNSAFE.sub("-", text).strip("-.") or "model"


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

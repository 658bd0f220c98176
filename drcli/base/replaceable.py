"""The files that commands write for their users: names that tell models apart; none is replaced."""

import re
import tempfile
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.private_files import make_folder

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


def safe_name(text: str) -> str:
    """A text, such as the prefix of a model, as part of the name of a file.

    All parts of a prefix are in it, so that `anna/m1` and `ben/m1` have files of their own.
    """
    return _UNSAFE.sub("-", text).strip("-.") or "model"


def refuse_existing(path: Path, *, force: bool) -> None:
    """Refuse to replace a file that exists, unless `force` (the option -f) is given.

    Raises:
        SettingsError: It exists, or is not a file.
    """
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
    """`refuse_existing`, and refuse a place where no file can be made.

    Raises:
        SettingsError: It is one of these.
    """
    if not path.parent.is_dir():
        raise _unwritable(path, f"the folder {path.parent} does not exist")
    refuse_existing(path, force=force)
    refuse_new_file(path)


def make_picture_folder(folder: Path) -> None:
    """Make a folder for pictures, if it does not exist.

    Raises:
        SettingsError: It cannot be made.
    """
    try:
        make_folder(folder)
    except OSError as error:
        raise SettingsError(
            f"{folder} cannot be made ({error.strerror or error}).",
            remedy="Name a folder that you can write to, such as --png pictures.",
        ) from None


def refuse_new_file(path: Path) -> None:
    """Refuse a place where no file can be made, by making one there for a moment.

    Raises:
        SettingsError: It is one.
    """
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

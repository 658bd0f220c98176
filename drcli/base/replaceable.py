"""Which files a picture, a page or a video may replace: those of its own kind."""

import re
import tempfile
from pathlib import Path
from typing import NamedTuple

from drcli.base.errors import SettingsError
from drcli.base.regular_file import read_regular

_START_BYTES = 256


class FileKind(NamedTuple):
    """A kind of file.

    Attributes:
        name: In a sentence, with its article.
        start: How its files start.
        example: An option that chooses another file.
    """

    name: str
    start: re.Pattern[bytes]
    example: str


PNG_PICTURE = FileKind("a PNG picture", re.compile(rb"\x89PNG\r\n\x1a\n"), "--out rewards.png")
HTML_PAGE = FileKind(
    "an HTML page",
    re.compile(rb"(\xef\xbb\xbf)?\s*(<!--.*?-->\s*)?<(!doctype html|html)", re.I | re.S),
    "--html page.html",
)
VIDEO = FileKind("a video", re.compile(rb"....ftyp|GIF8", re.S), "--out lap.mp4")


def refuse_replacing(path: Path, kind: FileKind = PNG_PICTURE) -> None:
    """Refuse to replace a file of another kind, or to write where no file can be made.

    Raises:
        SettingsError: It is one of these.
    """
    if not path.parent.is_dir():
        raise _unwritable(path, f"the folder {path.parent} does not exist")
    try:
        start = read_regular(path, _START_BYTES)
    except FileNotFoundError:
        refuse_new_file(path)
        return
    except OSError as error:
        raise _unwritable(path, error.strerror or str(error)) from None
    if start and not kind.start.match(start):
        option = kind.example.partition(" ")[0]
        raise SettingsError(
            f"{path} exists and is not {kind.name}, so it is not replaced.",
            remedy=f"Choose another file with {option}, such as {kind.example}.",
        )


def make_picture_folder(folder: Path) -> None:
    """Make a folder for pictures, if it does not exist.

    Raises:
        SettingsError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
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

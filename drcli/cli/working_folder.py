"""Finds the racer's working folder and reads its settings."""

import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.base.errors import SettingsError
from drcli.base.files import without_dots
from drcli.base.installation import lazy_imports
from drcli.cli import terminal

if TYPE_CHECKING:
    from drcli.config.settings import Settings

with lazy_imports():
    from drcli.config import loading


def working_folder() -> Path:
    """The folder of run.env: DR_DIR, else the current folder.

    Raises:
        SettingsError: The current folder was deleted.
    """
    named = os.environ.get("DR_DIR")
    try:
        here = current_folder()
    except SettingsError:
        if named and Path(named).is_absolute():
            return Path(named)
        raise
    folder = without_dots(here / named) if named else here
    if folder != here and (here / "run.env").is_file() and folder.resolve() != here.resolve():
        _mention(folder, here)
    return folder


def current_folder() -> Path:
    """The current folder.

    Raises:
        SettingsError: It was deleted.
    """
    try:
        return Path.cwd()
    except FileNotFoundError:
        raise SettingsError(
            "The current folder was deleted.",
            remedy="Change to another folder, for example with `cd ~/my-racer`, and try again.",
        ) from None


def settings() -> "Settings":
    """The settings of the working folder.

    Raises:
        SettingsError: One is wrong, or DR_DIR is.
    """
    folder = working_folder()
    if os.environ.get("DR_DIR") and not (folder / "run.env").is_file():
        raise SettingsError(
            f"environment: DR_DIR={folder} has no run.env.",
            remedy="Correct DR_DIR, or `unset DR_DIR` and change to the folder with your run.env.",
        )
    return loading.load_settings(folder)


def settings_or_defaults(flags: Mapping[str, str] | None = None) -> "Settings":
    """The settings; the defaults outside of a working folder.

    Raises:
        SettingsError: One is wrong, or DR_DIR is.
    """
    folder = working_folder()
    if os.environ.get("DR_DIR") or (folder / "run.env").exists():
        loaded = settings()
        return loading.load_settings(loaded.directory, flags=flags) if flags else loaded
    return loading.load_settings(folder, flags=flags, contents={"run.env": b""})


def settings_for_files(words: Sequence[str]) -> "Settings":
    """The settings; outside of a working folder, the defaults if all words name files.

    Raises:
        SettingsError: As for `settings`, or a word names no file.
    """
    folder = working_folder()
    if not words or (folder / "run.env").is_file() or os.environ.get("DR_DIR"):
        return settings()
    missing = [word for word in words if not Path(word).expanduser().exists()]
    for word in missing:
        if word.startswith((".", "~", "/")):
            raise SettingsError(
                f"{word} does not exist.", remedy="Check the path of the file or folder."
            )
    return settings() if missing else loading.load_settings(folder, contents={"run.env": b""})


@cache
def _mention(folder: Path, here: Path) -> None:
    terminal.warn(
        f"Using DR_DIR={folder}, not {here}, which has a run.env too. "
        "To use the current folder, `unset DR_DIR` or source its bin/activate.sh."
    )

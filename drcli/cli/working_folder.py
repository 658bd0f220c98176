"""The racer's working folder and its settings, as every command needs them."""

import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.base.errors import SettingsError

if TYPE_CHECKING:
    from drcli.config.settings import Settings


def working_folder() -> Path:
    """Where run.env lies: DR_DIR if that is set, else the current folder.

    Raises:
        SettingsError: It is, or lies in, a current folder that was deleted.
    """
    named = os.environ.get("DR_DIR")
    try:
        here = current_folder()
    except SettingsError:
        if named and Path(named).is_absolute():
            return Path(named)
        raise
    folder = here / named if named else here
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
            "The current folder is gone.",
            remedy="Change to one that is there, as with `cd ~/my-racer`, and run it again.",
        ) from None


def settings() -> "Settings":
    """The settings of the working folder.

    Raises:
        SettingsError: One is wrong, or DR_DIR is.
    """
    from drcli.config.settings import load_settings

    folder = working_folder()
    if os.environ.get("DR_DIR") and not (folder / "run.env").is_file():
        raise SettingsError(
            f"environment: DR_DIR={folder} holds no run.env.",
            remedy="Correct DR_DIR, or `unset DR_DIR` and change to the folder that holds one.",
        )
    return load_settings(folder)


@cache
def _mention(folder: Path, here: Path) -> None:
    """Say once which folder counts where somebody may expect another one."""
    from drcli.cli import console

    console.warn(
        f"DR_DIR={folder} counts, not {here}, which has a run.env too. "
        "To use that one, `unset DR_DIR` or source its bin/activate.sh."
    )

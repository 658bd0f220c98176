"""The racer's working folder and its settings, as every command needs them."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drcli.config import Settings


def working_folder() -> Path:
    """Where run.env lies: DR_DIR if that is set, else the current folder."""
    return Path(os.environ.get("DR_DIR") or Path.cwd()).absolute()


def settings() -> "Settings":
    """The settings of the working folder."""
    from drcli.config import load_settings

    return load_settings(working_folder())

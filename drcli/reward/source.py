"""Which file of a reward function is meant."""

from pathlib import Path

from drcli.config import Settings
from drcli.errors import SettingsError
from drcli.runs.inputs import shipped_file
from drcli.store import keys


def file_of(settings: Settings, file: Path | None) -> Path:
    """The file given, else the racer's own, else the shipped example.

    Raises:
        SettingsError: The file given does not exist.
    """
    if file is None:
        own = settings.custom_files_dir / keys.REWARD_FUNCTION_FILE
        return own if own.is_file() else shipped_file(keys.REWARD_FUNCTION_FILE)
    if file.is_dir():
        file = file / keys.REWARD_FUNCTION_FILE
    if not file.is_file():
        raise SettingsError(
            f"{file}: there is no such file.",
            remedy="Name a reward function, such as custom_files/reward_function.py, or none at "
            "all for that of your training.",
        )
    return file


def display_name(file: Path, directory: Path) -> str:
    """A file as a racer would write it: from the working folder where it lies below it."""
    path, folder = file.absolute(), directory.absolute()
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else str(file)

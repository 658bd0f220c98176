"""Which file of a reward function is meant."""

from collections.abc import Sequence
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.problems import Problem, ProblemsError
from drcli.config.example_files import model_file
from drcli.config.settings import Settings
from drcli.store import keys


def file_of(settings: Settings, file: Path | None) -> Path:
    """The file given, else the racer's own, else the shipped example.

    Raises:
        SettingsError: The file given does not exist.
    """
    if file is None:
        own = settings.custom_files_dir / keys.REWARD_FUNCTION_FILE
        return own if own.is_file() else model_file(keys.REWARD_FUNCTION_FILE)
    found = _inside(file)
    if not found.is_file():
        raise SettingsError(
            f"{found}: there is no such file.",
            remedy="Name a reward function, such as custom_files/reward_function.py, or none at "
            "all for that of your training.",
        )
    return found


def files_of(files: Sequence[Path]) -> list[Path]:
    """The files given, each of which must be there.

    Raises:
        ProblemsError: Some do not exist.
    """
    found = [_inside(file) for file in files]
    missing = [
        Problem(
            "V-02",
            "error",
            str(file),
            None,
            "there is no such file.",
            "Name a reward function, such as custom_files/reward_function.py.",
        )
        for file in found
        if not file.is_file()
    ]
    if missing:
        raise ProblemsError(missing)
    return found


def display_name(file: Path, directory: Path) -> str:
    """A file as a racer would write it: from the working folder where it lies below it."""
    path, folder = file.absolute(), directory.absolute()
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else str(file)


def _inside(file: Path) -> Path:
    """The reward function of a folder, or the file itself."""
    return file / keys.REWARD_FUNCTION_FILE if file.is_dir() else file

"""Finds the file of a reward function."""

from collections.abc import Sequence
from pathlib import Path

from drcli.base.problems import Problem, refuse
from drcli.config.example_files import model_file
from drcli.config.settings import Settings
from drcli.modelfiles.custom_files import FILE_RULES
from drcli.store import keys


def file_of(settings: Settings, file: Path | None) -> Path:
    """The given file, else the racer's own, else the shipped example.

    Raises:
        ProblemsError: The given file does not exist, or the racer has only other files.
    """
    if file is not None:
        return files_of([file])[0]
    own = settings.custom_files_dir / keys.REWARD_FUNCTION_FILE
    if own.is_file():
        return own
    example = model_file(own.name)
    others = [name for name in FILE_RULES if (own.parent / name).is_file()]
    if others:  # a single missing file is a mistake, as before a start
        what = f"{own.name} is missing in {own.parent}, which has {' and '.join(others)}."
        remedy = f"Put your {own.name} there; an example is {example}."
        refuse([Problem(FILE_RULES[own.name], "error", str(own.parent), None, what, remedy)])
    return example


def files_of(paths: Sequence[Path]) -> list[Path]:
    """The given files; for a folder, the reward function in it.

    Raises:
        ProblemsError: Some do not exist.
    """
    files = [path / keys.REWARD_FUNCTION_FILE if path.is_dir() else path for path in paths]
    what = "this file does not exist."
    remedy = "Give the path of a reward function, such as custom_files/reward_function.py."
    refuse(
        Problem("V-02", "error", str(file), None, what, remedy)
        for file in files
        if not file.is_file()
    )
    return files


def display_name(file: Path, directory: Path) -> str:
    """A file as a racer would write it: relative to the working folder, if it is inside."""
    path, folder = file.absolute(), directory.absolute()
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else str(file)

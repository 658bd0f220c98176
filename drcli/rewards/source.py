"""Reads the file of a reward function."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drcli.base.problems import Problem, refuse
from drcli.config.example_files import model_file
from drcli.config.settings import Settings
from drcli.modelfiles.custom_files import FILE_RULES, InputFile, local_file
from drcli.store.keys import REWARD_FUNCTION_FILE


def read_racers_file(settings: Settings, file: Path | None, directory: Path) -> InputFile:
    """The given file, else the racer's own, else the shipped example.

    Raises:
        ProblemsError: It cannot be read, or the racer has only other files.
    """
    own, example = (
        settings.custom_files_dir / REWARD_FUNCTION_FILE,
        model_file(REWARD_FUNCTION_FILE),
    )
    others = [name for name in FILE_RULES if (own.parent / name).is_file()]
    if file is None and others and not own.is_file():  # a mistake, as before a start
        what = f"{own.name} is missing in {own.parent}, which has {' and '.join(others)}."
        remedy = f"Put your {own.name} there; an example is {example}."
        refuse([Problem("V-02", "error", str(own.parent), None, what, remedy)])
    return read_files([file or (own if own.is_file() else example)], directory)[0]


def read_files(paths: Sequence[Path], directory: Path) -> list[InputFile]:
    """For a folder, the reward function in it; ProblemsError if unreadable."""
    files = [path / REWARD_FUNCTION_FILE if path.is_dir() else path for path in paths]
    read = [(file, local_file(file.parent, file.name)) for file in files]
    what = "this file does not exist."
    remedy = "Give the path of a reward function, such as custom_files/reward_function.py."
    refuse(
        Problem("V-02", "error", str(file), None, what, remedy) for file, own in read if own is None
    )
    return [replace(own, origin=display_name(file, directory)) for file, own in read if own]


def display_name(file: Path, directory: Path) -> str:
    """Relative to the working folder, if inside."""
    path, folder = file.absolute(), directory.absolute()
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else str(file)

"""Reads the file of a reward function."""

import re
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drcli.base.errors import Problem, ProblemsError, SettingsError, refuse
from drcli.config.presets import model_file
from drcli.config.settings import Settings
from drcli.model.files.custom_files import FILE_RULES, InputFile, local_file
from drcli.model.keys import REWARD_FUNCTION_FILE
from drcli.records.job import WorkerExit


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


def own_file(settings: Settings, name: str) -> InputFile | None:
    """Of the racer; None if it is missing or unreadable, which other checks tell."""
    try:
        return local_file(settings.custom_files_dir, name)
    except ProblemsError:
        return None


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


# Explains why a worker ended whose reward function was stuck in one operation.
#
# Python could not interrupt it; stacks are in its log.


_WHY = "one operation takes far longer than a call may, and Python cannot interrupt it"
_REMEDY = "Correct reward_function.py, then continue with `dr-start-training --resume-or-start`."

_TAIL_BYTES = 20_000
_THREAD = re.compile(r"^(?:Current thread|Thread) 0x", re.MULTILINE)
_ESCAPED = re.compile(r"\\x([0-9a-f]{2})|\\u([0-9a-f]{4})|\\U([0-9a-f]{8})")
_PLACE = re.compile(rf'File "(.*{re.escape(REWARD_FUNCTION_FILE)})", line (\d+) in')


def is_stuck(code: int) -> bool:
    return code < 0 and -code == getattr(signal, "SIGPROF", None)


def stuck_place(text: str) -> tuple[Path | None, int]:
    for stack in reversed(_THREAD.split(text)):
        found = _PLACE.search(stack)
        if found:
            return Path(_ESCAPED.sub(_letter, found[1])), int(found[2])
    return None, 0


def _letter(escaped: re.Match[str]) -> str:
    """Python's fault handler writes only ASCII."""
    return chr(int(next(filter(None, escaped.groups())), 16))


def exit_of_stuck(code: int, log: Path, *, remedy: str = _REMEDY) -> WorkerExit | None:
    """The error of a stuck worker, or None."""
    if not is_stuck(code):
        return None
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - _TAIL_BYTES))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        text = ""
    path, line = stuck_place(text)
    where = f" in {REWARD_FUNCTION_FILE}, line {line}," if line else ""
    what = f"Reward function error: The reward function{where} failed: {_WHY}."
    if source := source_line(path, line):
        what += f"\n  {source}"
    return WorkerExit(what, remedy, SettingsError.code, final=True)


def source_line(path: Path | None, line: int) -> str:
    try:
        lines = [] if path is None else path.read_text("utf-8", "replace").splitlines()
    except OSError:
        return ""
    return lines[line - 1].strip() if 0 < line <= len(lines) else ""

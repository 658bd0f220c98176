"""Changes settings in the racer's own files, and leaves everything else in them as it is."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.base.file_lock import only_writer
from drcli.base.problems import Place, Problem, ProblemsError, shown
from drcli.config import activation
from drcli.config.env_file import Entry, content_of, parse_env, with_any_value
from drcli.config.experiment import EXPERIMENT
from drcli.config.fields import FileName
from drcli.config.files import Files
from drcli.config.inspection import problems_of, warnings_of
from drcli.config.model import catalogue
from drcli.config.secrets import hidden
from drcli.config.setting_problems import setting_problem
from drcli.config.settings import active_run_file


@dataclass(frozen=True)
class Change:
    """What became of one setting.

    Attributes:
        name: The setting.
        before: Its text in the file, None where it did not stand there; a secret is hidden.
        after: Its text there now.
        file: The file, by its name in the working folder.
    """

    name: str
    before: str | None
    after: str
    file: str


@dataclass(frozen=True)
class Edit:
    """What was changed, and what is worth knowing about it.

    Attributes:
        directory: The working folder.
        changes: One for each setting.
        warnings: Sentences about what does not act as the racer may think.
    """

    directory: str
    changes: tuple[Change, ...]
    warnings: tuple[str, ...]


def set_values(
    directory: Path,
    wanted: Mapping[str, str],
    *,
    file: FileName | None = None,
    environ: Mapping[str, str] | None = None,
) -> Edit:
    """Write values into the files in which they belong.

    A name is changed where it stands; a new one goes to the file of its kind. Everything is checked
    before anything is written: mistakes that were there before may stay, none may come.

    Args:
        directory: The racer's working folder.
        wanted: Texts by name, maybe with `$NAME` in them.
        file: Write into that file instead; run.env is the one of the experiment, if there is one.
        environ: Process environment; `os.environ` when None.

    Raises:
        ProblemsError: A value would be wrong; nothing was changed.
        SettingsError: A file cannot be read or written.
    """
    outside = activation.chosen(os.environ if environ is None else environ)
    with only_writer(directory):
        flags = {EXPERIMENT: wanted[EXPERIMENT]} if EXPERIMENT in wanted else {}
        run_file = active_run_file(directory, flags=flags, environ=outside)
        Files(directory, {}).read(run_file)  # refuses a folder that has no run.env
        files = _Texts(directory, run_file)
        for name, value in wanted.items():
            files.set(name, value, files.named(file) if file else files.of(name))
        warnings = _refuse_mistakes(directory, wanted, files.changed, outside)
        for name, data in files.changed.items():
            rewrite(directory / name, data)
    stronger = [
        text for change in files.changes if (text := files.stronger(change, outside)) is not None
    ]
    return Edit(str(directory), tuple(files.changes), (*stronger, *warnings))


class _Texts:
    """The two files of a working folder while they are changed."""

    def __init__(self, directory: Path, run_file: str) -> None:
        self._run_file = run_file
        self._data = {
            name: content_of(path, name) if os.path.lexists(path := directory / name) else b""
            for name in (run_file, "system.env")
        }
        self._original = dict(self._data)
        self.changes: list[Change] = []

    @property
    def changed(self) -> dict[str, bytes]:
        """New contents by name."""
        return {name: data for name, data in self._data.items() if data != self._original[name]}

    def named(self, file: FileName) -> str:
        """The file as it is called in the working folder."""
        return self._run_file if file == "run.env" else file

    def of(self, name: str) -> str:
        """The file in which a name stands, else the one in which it belongs."""
        for file in self._data:
            if name in self._entries(file):
                return file
        known = catalogue().get(name)
        return self.named(known.file) if known is not None else self._run_file

    def set(self, name: str, value: str, file: str) -> None:
        """Change one value.

        Raises:
            ProblemsError: It cannot be written into its line.
        """
        old = self._entries(file).get(name)
        data = with_any_value(self._data[file], name, value, file)
        if data is None:
            place = Place(file) if old is None else old.place
            what = f"{name}={shown(hidden(name, value))} cannot be written into that line."
            remedy = f"Leave out line breaks, quotes, $ and \\, or edit {file} by hand."
            raise ProblemsError([setting_problem(name, place, what, remedy)])
        self._data[file] = data
        was = hidden(name, old.value) if old is not None else None
        self.changes.append(Change(name, was, hidden(name, value), file))

    def stronger(self, change: Change, environ: Mapping[str, str]) -> str | None:
        """Who wins over a changed value, as a sentence."""
        if environ.get(change.name, "").strip():
            return (
                f"environment: {change.name} is set there and wins over {change.file}. "
                f"Remove it with `unset {change.name}`."
            )
        winner = self._entries(self._run_file).get(change.name)
        if change.file == self._run_file or winner is None:
            return None
        return f"{winner.place}: {change.name} is set there too and wins over {change.file}."

    def _entries(self, file: str) -> dict[str, Entry]:
        return _entries(self._data[file], file)


def _entries(data: bytes, file: str) -> dict[str, Entry]:
    """The entries of a file by name, the last of a name counts."""
    return {entry.name: entry for entry in parse_env(data, file).entries}


def _refuse_mistakes(
    directory: Path,
    wanted: Mapping[str, str],
    contents: Mapping[str, bytes],
    environ: Mapping[str, str],
) -> list[str]:
    """Load the settings as they will be.

    Returns:
        What is odd about them that was not before.

    Raises:
        ProblemsError: Something is wrong that was not before, or a value that was just given.
    """
    # The environment would hide the values that are to be judged.
    others = {name: value for name, value in environ.items() if name not in wanted}
    before = problems_of(directory, others)
    problems = problems_of(directory, others, contents)
    errors = [problem for problem in problems if problem.severity == "error"]
    new = [error for error in errors if error not in before or error.key in wanted]
    if new:
        raise ProblemsError([_as_it_was(problem) for problem in new])
    left = [f"{error} This was wrong before." for error in errors]
    return [*left, *warnings_of(problem for problem in problems if problem not in before)]


def _as_it_was(problem: Problem) -> Problem:
    """A mistake that would stand in a line of a file, into which it was not written."""
    if problem.line is None:
        return problem
    return replace(problem, file=f"{problem.file} stays as it was", line=None)

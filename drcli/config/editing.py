"""Changes settings in the racer's own files, and leaves everything else in them as it is."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError
from drcli.base.file_lock import only_writer
from drcli.base.problems import Finding, FindingsError, shown
from drcli.config import activation
from drcli.config.env_file import Entry, content_of, parse_env, with_any_value
from drcli.config.experiment import EXPERIMENT
from drcli.config.fields import FileName
from drcli.config.model import catalogue
from drcli.config.secrets import hidden
from drcli.config.settings import active_run_file, load_settings
from drcli.config.worlds import fetchable, missing


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
        FindingsError: A value would be wrong; nothing was changed.
        SettingsError: A file cannot be read or written.
    """
    outside = activation.chosen(os.environ if environ is None else environ)
    with only_writer(directory):
        flags = {EXPERIMENT: wanted[EXPERIMENT]} if EXPERIMENT in wanted else {}
        files = _Files(directory, active_run_file(directory, flags=flags, environ=outside))
        for name, value in wanted.items():
            files.set(name, value, files.named(file) if file else files.of(name))
        warnings = _refuse_mistakes(directory, wanted, files.changed, outside)
        for name, data in files.changed.items():
            rewrite(directory / name, data)
    stronger = [
        text for change in files.changes if (text := files.stronger(change, outside)) is not None
    ]
    return Edit(str(directory), tuple(files.changes), (*stronger, *warnings))


class _Files:
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
            SettingsError: It cannot be written into its line.
        """
        old = self._entries(file).get(name)
        data = with_any_value(self._data[file], name, value, file)
        if data is None:
            raise SettingsError(
                f"{file if old is None else old.where}: {name}={shown(hidden(name, value))} cannot "
                "be written into that line.",
                remedy=f"Leave out line breaks, quotes, $ and \\, or edit {file} by hand.",
            )
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
        return f"{winner.where}: {change.name} is set there too and wins over {change.file}."

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
        FindingsError: Something is wrong that was not before, or a value that was just given.
    """
    # The environment would hide the values that are to be judged.
    others = {name: value for name, value in environ.items() if name not in wanted}
    old_mistakes, old_warnings = _judge(directory, {}, others)
    mistakes, warnings = _judge(directory, contents, others)
    about = tuple(f"{name}=" for name in wanted)
    new = [f for f in mistakes if f not in old_mistakes or f.what.startswith(about)]
    if new:
        raise FindingsError([_as_it_was(finding) for finding in new])
    left = [f"{finding} That was so before." for finding in mistakes]
    return [*left, *(text for text in warnings if text not in old_warnings)]


def _as_it_was(finding: Finding) -> Finding:
    """Where a mistake would stand in a file: nothing was written there."""
    file, line, _ = finding.where.partition(" line ")
    return replace(finding, where=f"{file} stays as it was") if line else finding


def _judge(
    directory: Path, contents: Mapping[str, bytes], environ: Mapping[str, str]
) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    try:
        settings = load_settings(directory, contents=contents, environ=environ)
    except FindingsError as error:
        return error.findings, error.warnings
    to_come = tuple(f"{finding} {finding.remedy}" for finding in fetchable(settings.races))
    return tuple(missing(settings.races)), (*settings.warnings, *to_come)

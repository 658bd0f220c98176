"""Changes values in settings files, and leaves everything else as it is."""

import codecs
import hashlib
import io
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from dotenv.parser import parse_stream

from drcli.base.errors import Place, Problem, ProblemsError, SettingsError, shown
from drcli.base.files import only_writer, read_regular, remedy_for, rewrite
from drcli.base.report import View
from drcli.config import activation
from drcli.config.fields import FileName, hidden, setting_problem
from drcli.config.loading import active_run_file
from drcli.config.settings import Settings, catalogue
from drcli.config.settings_files import (
    EXPERIMENT,
    LINE_END,
    Entry,
    SettingsFiles,
    content_of,
    parse_env,
    text_of,
)
from drcli.config.settings_report import check_settings, warnings_of

_QUOTED = re.compile(r"""([^\S\r\n]*)(['"])((?:\\.|(?!\2)[^\\])*)\2(.*)""", re.DOTALL)
_BARE = re.compile(
    r"([^\S\r\n]*?)((?:\S[^\r\n]*?)?)((?:[^\S\r\n]+#[^\r\n]*)?[^\S\r\n]*(?:\r\n|\n|\r)?)"
)


@dataclass(frozen=True)
class Change:
    """What happened to one setting."""

    name: Annotated[str, "The setting."]
    before: Annotated[
        str | None,
        "Its value in the file before the change, None if it was not there; secrets are hidden.",
    ]
    after: Annotated[str, "Its value there now."]
    file: Annotated[str, "The file, by its name in the working folder."]

    def __str__(self) -> str:
        before = "" if self.before is None else f"  (was {shown(self.before) or 'empty'})"
        return f"{self.file}: {self.name}={self.after}{before}"


@dataclass(frozen=True)
class Edit:
    """What was changed, and what is worth knowing about it."""

    directory: Annotated[str, "The working folder."]
    changes: Annotated[tuple[Change, ...], "One for each setting."]
    warnings: Annotated[tuple[str, ...], "Warnings about settings with a surprising effect."]

    def view(self) -> View:
        return map(str, self.changes)


class FilesChanged(SettingsError):
    """Somebody else has changed a file since it was read."""


def version_of(data: bytes | None) -> str:
    """Changes with the content; empty without a file."""
    return "" if data is None else hashlib.sha256(data).hexdigest()[:24]


def set_values(
    directory: Path,
    wanted: Mapping[str, str],
    *,
    file: FileName | None = None,
    environ: Mapping[str, str] | None = None,
    seen: Mapping[str, str] | None = None,
    keep_old: bool = False,
    write: bool = True,
) -> Edit:
    """Write values into the files in which they belong; run.env is that of the experiment.

    Everything is checked before anything is written: old mistakes may stay, new ones are refused.
    `seen` has versions of files that the values were made for. `keep_old` keeps NAME.bak.

    Raises:
        ProblemsError: A value would be wrong; nothing was changed.
        FilesChanged: A file is not as it was seen; nothing was changed.
        SettingsError: A file cannot be read or written.
    """
    outside = activation.chosen(os.environ if environ is None else environ)
    with only_writer(directory):
        flags = {EXPERIMENT: wanted[EXPERIMENT]} if EXPERIMENT in wanted else {}
        run_file = active_run_file(directory, flags=flags, environ=outside)
        SettingsFiles(directory).read(run_file)  # refuses a folder that has no run.env
        files = _Texts(directory, run_file)
        for name, version in (seen or {}).items():
            files.refuse_other(name, version)
        for name, value in wanted.items():
            files.set(name, value, files.named(file) if file else files.of(name))
        warnings = _refuse_mistakes(directory, wanted, files.changed, outside)
        for name, data in files.changed.items() if write else ():
            if keep_old:
                rewrite(directory / f"{name}.bak", files.original(name))
            rewrite(directory / name, data)
    stronger = [
        text for change in files.changes if (text := files.stronger(change, outside)) is not None
    ]
    return Edit(str(directory), tuple(files.changes), (*stronger, *warnings))


def replace_line(directory: Path, name: str, line: int, text: str, seen: str) -> None:
    """Write another text into a line that is wrong, and keep the old file as NAME.bak.

    Args:
        directory: The working folder.
        name: run.env, its own name in an experiment, or system.env.
        line: From 1.
        text: A NAME=value line, a comment, or nothing.
        seen: Version of the file that has this line.

    Raises:
        FilesChanged: It is another version.
        ProblemsError: The text would be wrong there, too; nothing was changed.
        SettingsError: The file has no such line, or cannot be read or written.
    """
    with only_writer(directory):
        files = _Texts(directory, name)
        files.refuse_other(name, seen)
        data = files.original(name)
        lines = text_of(data, name).splitlines(keepends=True)
        if not 1 <= line <= len(lines) or LINE_END.search(text):
            raise SettingsError(f"{name} has no such line.", remedy="Read the page again.")
        end = LINE_END.search(lines[line - 1])
        lines[line - 1] = text + ("" if end is None else end[0])
        mark = codecs.BOM_UTF8 if data.startswith(codecs.BOM_UTF8) else b""
        changed = mark + "".join(lines).encode()
        wrong = [each for each in parse_env(changed, name).problems if each.line == line]
        if wrong:
            raise ProblemsError(wrong)
        rewrite(directory / f"{name}.bak", data)
        rewrite(directory / name, changed)


def with_values(data: bytes, values: Mapping[str, str], name: str) -> bytes:
    """The content of a settings file with other values for some names.

    All else stays: comments, order, quotes, line ends, byte order mark. Of a name twice, the last
    line is changed; a new one goes to the end. Values must have no quotes or line breaks.

    Raises:
        ProblemsError: The content is not text.
    """
    text = text_of(data, name)
    bindings = list(parse_stream(io.StringIO(text, newline="")))
    lines = [binding.original.string for binding in bindings]
    places = {binding.key: index for index, binding in enumerate(bindings) if binding.key}
    ends = LINE_END.search(text)
    end = ends[0] if ends is not None else "\n"
    for key, value in values.items():
        if key in places:
            lines[places[key]] = _line_with(lines[places[key]], value)
            continue
        if lines and not lines[-1].endswith(("\n", "\r")):
            lines[-1] += end
        lines.append(f"{key}={value}{end}")
    mark = codecs.BOM_UTF8 if data.startswith(codecs.BOM_UTF8) else b""
    return mark + "".join(lines).encode()


def with_any_value(data: bytes, key: str, value: str, name: str) -> bytes | None:
    """One value, quoted where needed; None where that is impossible.

    Raises:
        ProblemsError: The content is not text.
    """
    before = {entry.name: entry.value for entry in parse_env(data, name).entries}
    if any("\ud800" <= character <= "\udfff" for character in value):
        return None  # other bytes of a command line arrive as these
    for written in (value, f'"{value}"', f"'{value}'"):
        changed = with_values(data, {key: written}, name)
        after = parse_env(changed, name).last
        read = {entry.name: entry.value for entry in after.values()}
        if read == {**before, key: value} and (after[key].expands or "$" not in value):
            return changed
    return None


def _line_with(line: str, value: str) -> str:
    head, equals, rest = line.partition("=")
    quoted = _QUOTED.fullmatch(rest)
    if quoted is not None:
        space, quote, _, behind = quoted.groups()
        return f"{head}{equals}{space}{quote}{value}{quote}{behind}"
    bare = _BARE.fullmatch(rest)
    space, behind = (bare[1], bare[3]) if bare is not None else ("", "")
    return f"{head}{equals}{space}{value}{behind}"


class _Texts:
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
        return {name: data for name, data in self._data.items() if data != self._original[name]}

    def original(self, name: str) -> bytes:
        return self._original[name]

    def refuse_other(self, name: str, version: str) -> None:
        if name in self._original and version_of(self._original[name]) != version:
            raise FilesChanged(
                f"{name} was changed on the disk after this page had read it.",
                remedy="Compare both versions, and choose which one to keep.",
            )

    def named(self, file: FileName) -> str:
        return self._run_file if file == "run.env" else file

    def of(self, name: str) -> str:
        for file in self._data:
            if name in self._entries(file):
                return file
        known = catalogue().get(name)
        return self.named(known.file) if known is not None else self._run_file

    def set(self, name: str, value: str, file: str) -> None:
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
        if environ.get(change.name, "").strip():
            return (
                f"environment: {change.name} is set there and overrides {change.file}. "
                f"Remove it with `unset {change.name}`."
            )
        winner = self._entries(self._run_file).get(change.name)
        if change.file == self._run_file or winner is None:
            return None
        return f"{winner.place}: {change.name} is set there too and overrides {change.file}."

    def _entries(self, file: str) -> dict[str, Entry]:
        return parse_env(self._data[file], file).last


def _refuse_mistakes(
    directory: Path,
    wanted: Mapping[str, str],
    contents: Mapping[str, bytes],
    environ: Mapping[str, str],
) -> list[str]:
    """Returns what is newly odd."""
    # The environment would hide the values that are to be checked.
    others = {name: value for name, value in environ.items() if name not in wanted}
    # A track may be named before it is fetched.
    before = check_settings(directory, others, known_suffices=True).problems
    after = check_settings(directory, others, contents, known_suffices=True)
    new = [error for error in after.errors if error not in before or error.key in wanted]
    if new:
        raise ProblemsError([_as_it_was(problem) for problem in new])
    left = [f"{error} This was wrong before." for error in after.errors]
    return [*left, *warnings_of(problem for problem in after.problems if problem not in before)]


def _as_it_was(problem: Problem) -> Problem:
    if problem.line is None:
        return problem
    return replace(problem, file=f"{problem.file} stays as it was", line=None)


# Edits the active run.env in one step, with a copy of the old file.


DELIMITER = "-"
_REFERENCE = re.compile(r"\$\{\w+(?::-[^}]*)?\}|\$[A-Za-z_]\w*", re.ASCII)
_NAME_AT_END = re.compile(r"\$([A-Za-z_]\w*)\Z", re.ASCII)


@dataclass(frozen=True)
class RunEnvEdit:
    """A run.env before and after the edit."""

    directory: Path
    path: Path
    old: bytes
    new: bytes

    @property
    def backup(self) -> Path:
        return self.path.with_name(f"{self.path.name}.bak")

    def check(self) -> None:
        """Refuse a file that was changed since it was read.

        Raises:
            SettingsError: It was.
        """
        if read_regular(self.path) != self.old:
            raise SettingsError(
                f"{self.path} changed while this command was waiting.",
                remedy="Run the command again.",
            )

    def make(self) -> None:
        """Keep a copy of the file and replace it in one step.

        Raises:
            SettingsError: The file was changed since it was read, or cannot be written.
        """
        with only_writer(self.directory):
            self.check()
            try:
                shutil.copy2(self.path, self.backup)
            except OSError as e:
                raise SettingsError(
                    f"{self.path}: cannot be copied to {self.backup.name} ({e.strerror or e}).",
                    remedy=remedy_for(
                        e, self.path, f"Check that you can write {self.path} and its folder."
                    ),
                ) from e
            rewrite(self.path, self.new)


def file_name(settings: Settings) -> str:
    """Path below the working folder."""
    name = settings.experiment_name
    return f"experiments/{name}/run.env" if name else active_run_file(settings.directory)


def plan_edit(
    settings: Settings, values: Mapping[str, str], texts: Mapping[str, str] | None = None
) -> RunEnvEdit:
    """Work out an edit with `values`, or with any `texts`, which get quotes where needed.

    Raises:
        SettingsError: The environment has a name too, or a text cannot be written.
    """
    texts = texts or {}
    refuse_stronger_values(settings, (*values, *texts))
    name = file_name(settings)
    path = settings.directory / name
    old = read_regular(path)
    new = with_values(old, values, name)
    for key, text in texts.items():
        changed = with_any_value(new, key, text, name)
        if changed is None:
            raise SettingsError(
                f"{key}={shown(hidden(key, text))} cannot be written into a line of {name}.",
                remedy="Leave out line breaks, quotes, $ and \\.",
            )
        new = changed
    return RunEnvEdit(settings.directory, path, old, new)


def refuse_stronger_values(settings: Settings, names: Iterable[str]) -> None:
    """Refuse to edit settings that the environment has too.

    Raises:
        SettingsError: One of the names is set there.
    """
    for name in names:
        if settings.source(name) == "environment":
            raise SettingsError(
                f"environment: {name} is set there and would override {file_name(settings)}.",
                remedy=f"Remove it with `unset {name}` and run the command again.",
            )


def raised(text: str, prefix: str, delimiter: str | None = None) -> tuple[str, str]:
    """Text and prefix of the next model: the number at its end plus one, or a first number.

    Leading zeros stay, so m-09 becomes m-10. A name that is only a number gets a second one;
    digits of a `$NAME` do not count.
    """
    digits = _number_at_end(text, delimiter)
    if digits:
        number = str(int(digits) + 1).zfill(len(digits))
        return text.removesuffix(digits) + number, prefix.removesuffix(digits) + number
    number = f"{delimiter or DELIMITER}1"
    if re.match(r"\w", number):
        # Without braces, `$NAME` and `_1` would be read as one name.
        text = _NAME_AT_END.sub(r"${\1}", text)
    return text + number, prefix + number


def _number_at_end(text: str, delimiter: str | None) -> str:
    literal = max((match.end() for match in _REFERENCE.finditer(text)), default=0)
    found = re.search(r"[0-9]+\Z", text[literal:])
    if found is None:
        return ""
    name = text.removesuffix(found[0])
    counts = bool(name) if delimiter is None else name.endswith(delimiter)
    return found[0] if counts else ""

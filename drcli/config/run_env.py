"""Edits the active run.env in one step, with a copy of the old file."""

import re
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.base.atomic_file import remedy_for, rewrite
from drcli.base.errors import SettingsError
from drcli.base.file_lock import only_writer
from drcli.base.problems import shown
from drcli.base.regular_file import read_regular
from drcli.config.editing import with_any_value, with_values
from drcli.config.loading import active_run_file
from drcli.config.setting_problems import hidden
from drcli.config.settings import Settings
from drcli.config.settings_files import parse_env

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


def written(settings: Settings, name: str) -> str | None:
    """The text of a setting in that file, with `$NAME`."""
    file = file_name(settings)
    entry = parse_env(read_regular(settings.directory / file), file).last.get(name)
    return None if entry is None else entry.value


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

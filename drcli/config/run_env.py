"""Edits the run.env that counts: new values in one step, with a copy of the file as it was."""

import re
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.base.atomic_file import remedy_for, rewrite
from drcli.base.errors import SettingsError
from drcli.base.file_lock import only_writer
from drcli.config.editing import with_values
from drcli.config.loading import active_run_file
from drcli.config.settings import Settings
from drcli.config.settings_files import parse_env

DELIMITER = "-"
"""Stands before the number of a name that has none yet."""

_REFERENCE = re.compile(r"\$\{\w+(?::-[^}]*)?\}|\$[A-Za-z_]\w*", re.ASCII)
_NAME_AT_END = re.compile(r"\$([A-Za-z_]\w*)\Z", re.ASCII)


@dataclass(frozen=True)
class Edit:
    """A file and what it will hold.

    Attributes:
        old: Its content when it was looked at.
        new: Its content afterwards.
    """

    directory: Path
    name: str
    old: bytes
    new: bytes

    @property
    def path(self) -> Path:
        """The file."""
        return self.directory / self.name

    @property
    def backup(self) -> Path:
        """Where the copy of the old content goes."""
        return self.path.with_name(f"{self.path.name}.bak")

    def check(self) -> None:
        """Refuse if the file has been changed since it was read.

        Raises:
            SettingsError: They have.
        """
        if self.path.read_bytes() != self.old:
            raise SettingsError(
                f"{self.path}: was changed while this command waited.",
                remedy="Run the command again.",
            )

    def make(self) -> None:
        """Keep a copy of the file and replace it in one step.

        Raises:
            SettingsError: The file was changed since it was looked at, or cannot be written.
        """
        with only_writer(self.directory):
            self.check()
            try:
                shutil.copy2(self.path, self.backup)
            except OSError as e:
                raise SettingsError(
                    f"{self.path}: cannot be copied to {self.backup.name} ({e.strerror or e}).",
                    remedy=remedy_for(
                        e, self.path, f"Check that you may write {self.path} and its folder."
                    ),
                ) from e
            rewrite(self.path, self.new)


def file_name(settings: Settings) -> str:
    """The run.env that counts, below the working folder: an experiment has its own."""
    name = settings.experiment_name
    return f"experiments/{name}/run.env" if name else active_run_file(settings.directory)


def written(settings: Settings, name: str) -> str | None:
    """The text that stands for a name in that file, maybe with `$NAME` in it; None without one."""
    file = file_name(settings)
    entries = parse_env((settings.directory / file).read_bytes(), file).entries
    return next((entry.value for entry in reversed(entries) if entry.name == name), None)


def plan_edit(settings: Settings, values: Mapping[str, str]) -> Edit:
    """Work out an edit; nothing is changed yet.

    Raises:
        SettingsError: One of the names is set in the environment, which would win.
    """
    refuse_stronger_values(settings, values)
    name = file_name(settings)
    directory = settings.directory
    old = (directory / name).read_bytes()
    return Edit(directory, name, old, with_values(old, values, name))


def refuse_stronger_values(settings: Settings, names: Iterable[str]) -> None:
    """What the environment says wins over run.env, so that an edit there would do nothing.

    Raises:
        SettingsError: It says something about one of the names.
    """
    for name in names:
        if settings.source(name) == "environment":
            raise SettingsError(
                f"environment: {name} is set there and would win over {file_name(settings)}.",
                remedy=f"Remove it with `unset {name}` and run the command again.",
            )


def raised(text: str, prefix: str, delimiter: str | None = None) -> tuple[str, str]:
    """The name of the next model: the number at its end raised, or a first number behind it.

    Leading zeros stay, so m-09 becomes m-10. A name that is nothing but a number gets another one,
    and digits that belong to a `$NAME` are none.

    Args:
        text: The prefix as it stands in the file, maybe with `$NAME` in it.
        prefix: The same with everything filled in.
        delimiter: What must stand before the number; anything but a digit if left out.

    Returns:
        Both as they are for the next model.
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

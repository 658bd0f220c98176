"""Reads the files of a working folder into entries, and notes what is wrong or odd in them."""

import os
from collections.abc import Mapping
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.problems import Finding
from drcli.config.env_file import Entry, EnvFile, parse_env, read_env_file


class Files:
    """The settings files of one folder.

    Args:
        directory: The folder, absolute.
        contents: Content of files, by name, to be taken for what lies there.
    """

    def __init__(self, directory: Path, contents: Mapping[str, bytes]) -> None:
        self.directory = directory
        self.contents = contents
        self.findings: list[Finding] = []
        """What is wrong in the files that were read so far."""
        self.warnings: list[str] = []
        """What is odd in them."""
        self.complete = True
        """Whether each of them could be read, apart from single lines."""

    def exist(self, name: str) -> bool:
        """Whether there is a file of that name, or a link that leads nowhere."""
        return name in self.contents or os.path.lexists(self.directory / name)

    def read(self, name: str) -> dict[str, Entry]:
        """The entries of a file; a repeated name counts as last written, as in a shell.

        Raises:
            SettingsError: There is no such file.
        """
        entries: dict[str, Entry] = {}
        before: dict[str, str] = {}
        for entry in self._content(name).entries:
            if entry.name in entries:
                before[entry.name] = entries[entry.name].where
            entries[entry.name] = entry
        self.warnings += [
            f"{entries[name].where}: {name} stands at {place} too; the later line counts."
            for name, place in before.items()
        ]
        return entries

    def experiments(self) -> list[str]:
        """Names of the folders in experiments/ that hold a run.env."""
        found = (self.directory / "experiments").glob("*/run.env")
        return sorted(path.parent.name for path in found)

    def _content(self, name: str) -> EnvFile:
        """A file taken apart; a finding and nothing in it where it cannot be read."""
        if not self.exist(name):
            raise SettingsError(
                f"{name}: there is no such file in {self.directory}.",
                remedy=f"Change to the folder that holds {name}, or create one with `dr init`.",
            )
        try:
            if name in self.contents:
                content = parse_env(self.contents[name], name)
            else:
                content = read_env_file(self.directory / name, name)
        except SettingsError as error:
            self.complete = False
            content = EnvFile((), (Finding.of(error),))
        self.findings += content.findings
        return content

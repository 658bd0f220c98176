"""Reads the files of a working folder into entries, and collects the problems in them."""

import os
from collections.abc import Mapping
from pathlib import Path

from drcli.base.problems import Place, Problem, ProblemsError
from drcli.config.env_file import Entry, EnvFile, parse_env, read_env_file
from drcli.config.setting_problems import file_problem, setting_problem


class Files:
    """The settings files of one folder.

    Args:
        directory: The folder, absolute.
        contents: Content of files, by name, that replaces what is on the disk.
    """

    def __init__(self, directory: Path, contents: Mapping[str, bytes]) -> None:
        self.directory = directory
        self.contents = contents
        self.problems: list[Problem] = []
        """What is wrong or odd in the files that were read so far."""
        self.complete = True
        """Whether each of them could be read, apart from single lines."""

    def exist(self, name: str) -> bool:
        """Whether there is a file of that name, or a link that leads nowhere."""
        return name in self.contents or os.path.lexists(self.directory / name)

    def read(self, name: str) -> dict[str, Entry]:
        """The entries of a file; the last line of a repeated name counts, as in a shell.

        Raises:
            ProblemsError: There is no such file.
        """
        entries: dict[str, Entry] = {}
        before: dict[str, Place] = {}
        for entry in self._content(name).entries:
            if entry.name in entries:
                before[entry.name] = entries[entry.name].place
            entries[entry.name] = entry
        self.problems += [
            setting_problem(
                key,
                entries[key].place,
                f"{key} is also set at {place}; the later line counts.",
                "Remove one of the lines.",
                severity="warning",
            )
            for key, place in before.items()
        ]
        return entries

    def experiments(self) -> list[str]:
        """Names of the folders in experiments/ that hold a run.env."""
        found = (self.directory / "experiments").glob("*/run.env")
        return sorted(path.parent.name for path in found)

    def _content(self, name: str) -> EnvFile:
        """The content of a file; a problem and no entries where it cannot be read."""
        if not self.exist(name):
            what = f"there is no such file in {self.directory}."
            remedy = f"Change to the folder that holds {name}, or create one with `dr init`."
            raise ProblemsError([file_problem(Place(name), what, remedy)])
        try:
            if name in self.contents:
                content = parse_env(self.contents[name], name)
            else:
                content = read_env_file(self.directory / name, name)
        except ProblemsError as error:
            self.complete = False
            content = EnvFile((), error.problems)
        self.problems += content.problems
        return content

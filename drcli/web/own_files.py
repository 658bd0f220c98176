"""The racer's three files, read with a version, saved with a backup."""

from dataclasses import dataclass, replace
from typing import Any

from drcli.base.errors import DrError, ProblemsError
from drcli.base.files import only_writer
from drcli.bucket.connect import open_running_bucket
from drcli.config.editing import FilesChanged, version_of
from drcli.config.presets import model_file
from drcli.config.settings import Settings
from drcli.model.files.custom_files import FILE_RULES, InputFile, find, local_file
from drcli.model.files.data_file import read_json_object
from drcli.rewards.source import display_name
from drcli.transfer.copy_custom_files import BACKUP, write_file
from drcli.web.answers import Body


class Save(Body):
    """Of the file as the page has read it; `shipped`: to begin again from the shipped one."""

    version: str
    shipped: bool = False


@dataclass(frozen=True)
class OwnFile:
    """One of the three files.

    Attributes:
        shown: Where it will be saved, as a racer writes it.
        origin: Of the content: "own", "bucket" or "shipped".
        version: Of the racer's own file; empty if there is none.
    """

    name: str
    data: bytes
    shown: str
    origin: str
    version: str

    @property
    def text(self) -> str:
        return self.data.decode("utf-8", "replace")

    @property
    def input(self) -> InputFile:
        return InputFile(self.name, self.data, self.shown)

    def facts(self) -> dict[str, Any]:
        return {"file": self.shown, "origin": self.origin, "version": self.version}


def own_file(settings: Settings, name: str) -> OwnFile:
    """The file that a start would take, or the shipped one; ProblemsError if unreadable."""
    folder = settings.custom_files_dir
    shown = display_name(folder / name, settings.directory)
    local = local_file(folder, name)
    if local is not None:
        return OwnFile(name, local.data, shown, "own", version_of(local.data))
    found = _elsewhere(settings).get(name)
    if found is not None and found.origin != str(model_file(name)):
        return OwnFile(name, found.data, shown, "bucket", "")
    return OwnFile(name, model_file(name).read_bytes(), shown, "shipped", "")


def values_of(file: OwnFile, rule: str) -> dict[str, Any] | None:
    try:
        return dict(read_json_object(file.data, file.shown, rule).values)
    except ProblemsError:
        return None


def base_of(file: OwnFile, body: Save) -> OwnFile:
    if not body.shipped:
        return file
    return replace(file, data=model_file(file.name).read_bytes())


def save_own_file(settings: Settings, name: str, data: bytes, seen: str) -> dict[str, Any]:
    """Save a file and keep the old one as NAME.bak; returns its facts and what else was written.

    A training takes the shipped files only if there is none of the racer's, so the others are saved
    as well if they were shipped ones.

    Raises:
        FilesChanged: The file is no longer the version `seen`.
        SettingsError: It cannot be written.
    """
    folder = settings.custom_files_dir
    with only_writer(settings.directory):
        before = local_file(folder, name)
        if version_of(None if before is None else before.data) != seen:
            raise FilesChanged(
                f"{display_name(folder / name, settings.directory)} was changed on the disk after "
                "this page had read it.",
                remedy="Compare both versions, and choose which one to keep.",
            )
        others = [
            each
            for other in FILE_RULES
            if other != name and (each := own_file(settings, other)).origin == "shipped"
        ]
        changed = write_file(folder / name, data)
        for each in others:
            write_file(folder / each.name, each.data)
    return {
        **own_file(settings, name).facts(),
        "changed": changed,
        "backup": f"{name}{BACKUP}" if changed and before is not None else None,
        "others": [each.shown for each in others],
    }


def _elsewhere(settings: Settings) -> dict[str, InputFile]:
    try:
        return find(settings.custom_files, open_running_bucket(settings.storage))
    except DrError:  # the bucket is away, or another file cannot be read: told by the check
        return {}

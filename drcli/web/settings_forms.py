"""run.env and system.env for the page."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drcli.base.problems import Problem, ProblemsError
from drcli.config import activation
from drcli.config.editing import version_of
from drcli.config.fields import Setting
from drcli.config.loading import active_run_file, load_settings
from drcli.config.setting_problems import HIDDEN, hidden
from drcli.config.settings import Settings, catalogue
from drcli.config.settings_files import Entry, Layers, SettingsFiles, content_of, given
from drcli.config.settings_report import check_settings
from drcli.web.answers import placed

SYSTEM = "system.env"


@dataclass(frozen=True)
class FolderFiles:
    """The settings files of a working folder.

    Attributes:
        run_file: The active run.env, below the folder.
        versions: By name; empty for a missing file.
        entries: By file and name.
    """

    run_file: str
    versions: Mapping[str, str]
    entries: Mapping[str, Mapping[str, Entry]]

    @staticmethod
    def read(directory: Path) -> "FolderFiles":
        """Leaves out wrong lines; ProblemsError if there is no run.env or experiment."""
        directory = directory.absolute()
        run_file = active_run_file(directory)
        files = SettingsFiles(directory)
        entries = {run_file: files.read(run_file)}
        entries[SYSTEM] = files.read(SYSTEM) if files.exist(SYSTEM) else {}
        versions = {name: _version(directory, name) for name in entries}
        return FolderFiles(run_file, versions, entries)


def _version(directory: Path, name: str) -> str:
    path = directory / name
    # As in `set_values`, a file that does not exist is an empty one.
    return version_of(content_of(path, name) if os.path.lexists(path) else b"")


def form_of(directory: Path) -> dict[str, Any]:
    files = FolderFiles.read(directory)
    try:
        settings: Settings | None = load_settings(directory)
    except ProblemsError:
        settings = None
    outside = given(activation.chosen(os.environ), "environment")
    layers = Layers(
        [outside, files.entries[files.run_file], files.entries[SYSTEM]],
        {name: setting.default_text for name, setting in catalogue().items()},
    )
    groups: dict[str, list[dict[str, Any]]] = {}
    for name, setting in catalogue().items():
        groups.setdefault(setting.group, []).append(_field(name, setting, files, layers, settings))
    check = check_settings(directory)
    return {
        "directory": str(directory),
        "run_file": files.run_file,
        "versions": files.versions,
        "groups": [{"title": title, "settings": fields} for title, fields in groups.items()],
        "problems": [placed(problem) for problem in shown_problems(check.problems)],
    }


def shown_problems(problems: tuple[Problem, ...]) -> list[Problem]:
    """Errors first; notes are for the start."""
    found = [problem for problem in problems if problem.severity != "note"]
    return sorted(found, key=lambda problem: problem.severity != "error")


def is_secret(name: str, text: str) -> bool:
    """May be replaced, but not shown."""
    return hidden(name, "x") == HIDDEN or hidden(name, text) != text


def _field(
    name: str, setting: Setting, files: FolderFiles, layers: Layers, settings: Settings | None
) -> dict[str, Any]:
    entry = layers.find(name)
    place = next((places[name] for places in files.entries.values() if name in places), None)
    value = layers.text(name) or ""
    if settings is not None and setting.kind != "path":
        value = setting.text(getattr(settings, setting.field))
    written = None if place is None else place.value
    secret = is_secret(name, value) or is_secret(name, written or "")
    return {
        "name": name,
        "kind": setting.kind,
        "choices": setting.choices,
        "low": setting.low,
        "high": setting.high,
        "meaning": setting.meaning,
        "expected": setting.expected,
        "default": setting.default_text,
        "effect": setting.effect,
        "reason": setting.reason,
        "value": hidden(name, value),
        "written": None if written is None else hidden(name, written),
        "set": bool(value),
        "secret": secret,
        "source": "default" if entry is None else str(entry.place),
        "file": files.run_file if setting.file == "run.env" else SYSTEM,
        "place": None if place is None else str(place.place),
        "environment": entry is not None and entry.place.file == "environment",
    }


def written_values(directory: Path, names: list[str]) -> dict[str, str | None]:
    files = FolderFiles.read(directory)
    found: dict[str, str | None] = {}
    for name in names:
        entry = next((each[name] for each in files.entries.values() if name in each), None)
        found[name] = None if entry is None else hidden(name, entry.value)
    return found

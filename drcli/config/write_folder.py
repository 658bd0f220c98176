"""Writes a planned working folder: all of it or nothing."""

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.base.atomic_file import remedy_for, rewrite
from drcli.base.errors import SettingsError
from drcli.base.file_lock import only_writer
from drcli.base.private_files import hand_out
from drcli.base.problems import Place, ProblemsError
from drcli.config.setting_problems import file_problem
from drcli.config.settings_files import content_of


@dataclass(frozen=True)
class NewFile:
    """Its name is a path below the working folder."""

    name: str
    data: bytes


@dataclass(frozen=True)
class FolderPlan:
    """What is about to be written; `missing_track` has to be fetched first."""

    folder: Path
    files: tuple[NewFile, ...]
    folders: tuple[str, ...]
    missing_track: str | None = None
    warnings: tuple[str, ...] = ()

    @property
    def clashes(self) -> list[str]:
        """Files that exist with other content."""
        return [file.name for file in self.files if _differs(self.folder / file.name, file.data)]


@dataclass(frozen=True)
class FolderReport:
    """What was written.

    Attributes:
        folder: The working folder.
        written: Files, by their path below it.
        unchanged: Files that were as they should be.
        backups: Copies of files that were replaced.
        warnings: Things that are allowed but may surprise you.
        model: Address in the bucket of the ready-made model; empty without one.
        checkpoint: Name of its checkpoint.
    """

    folder: str
    written: list[str]
    unchanged: list[str]
    backups: list[str]
    warnings: list[str]
    model: str = ""
    checkpoint: str = ""


def write(plan: FolderPlan) -> FolderReport:
    """Write what was planned. A file that is replaced is kept as .bak.

    Raises:
        ProblemsError: Something is in the way; nothing was written.
        SettingsError: Something cannot be written; all is as it was.
    """
    _refuse_obstacles(plan)
    written, unchanged, backups = [], [], []
    with ExitStack() as undo:
        _make_folders(plan.folder, undo)
        with only_writer(plan.folder):
            for name in plan.folders:
                _make_folders(plan.folder / name, undo)
            for file in plan.files:
                path = plan.folder / file.name
                before = _content(path)
                if before == file.data:
                    unchanged.append(file.name)
                    continue
                _make_folders(path.parent, undo)
                if _differs(path, file.data):
                    copy = _free_name(path)
                    undo.callback(_try, copy.unlink)
                    rewrite(copy, before or b"")
                    backups.append(str(copy.relative_to(plan.folder)))
                if before is None:
                    undo.callback(_try, path.unlink)
                else:
                    undo.callback(_try, rewrite, path, before)
                rewrite(path, file.data)
                written.append(file.name)
        undo.pop_all()  # everything was written
    return FolderReport(str(plan.folder), written, unchanged, backups, list(plan.warnings))


def _refuse_obstacles(plan: FolderPlan) -> None:
    found: dict[Path, str] = {}
    for name in ("", *plan.folders):
        if not (plan.folder / name).is_dir():
            found |= _obstacle(plan.folder / name)
    for file in plan.files:
        path = Path(os.path.realpath(plan.folder / file.name))
        if path.exists() and not path.is_file():
            found[path] = "is not a file, and one has to be written there"
        elif _content(path) == file.data:
            continue
        elif path.is_file() and not os.access(path, os.W_OK):
            found[path] = "is write-protected"
        else:
            found |= _obstacle(path.parent)
    if found:
        remedy = "Move it away or change its rights, or choose another folder."
        raise ProblemsError(
            file_problem(Place(str(path)), f"{what}.", remedy) for path, what in found.items()
        )


def _obstacle(folder: Path) -> dict[Path, str]:
    nearest = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
    if not nearest.is_dir():
        return {nearest: "is not a folder, so nothing can be written in it"}
    if not os.access(nearest, os.W_OK | os.X_OK):
        return {nearest: "is write-protected"}
    return {}


def _try(step: Callable[..., object], *args: object) -> None:
    with suppress(OSError, SettingsError):
        step(*args)


def _differs(path: Path, data: bytes) -> bool:
    if path.name == ".gitignore":  # its lines are kept
        return False
    return _content(path) not in (None, data)


def _content(path: Path) -> bytes | None:
    return content_of(path, str(path)) if path.is_file() else None


def _free_name(path: Path) -> Path:
    names = (f"{path.name}.bak{number or ''}" for number in range(1000))
    return next(path.with_name(name) for name in names if not path.with_name(name).exists())


def _make_folders(path: Path, undo: ExitStack) -> None:
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    for folder in reversed(missing):
        try:
            folder.mkdir(exist_ok=True)
            hand_out(folder)
        except OSError as e:
            raise SettingsError(
                f"{folder}: this folder cannot be created ({e.strerror or e}).",
                remedy=remedy_for(
                    e, folder, "Choose another folder, or check that you can write there."
                ),
            ) from e
        undo.callback(_try, folder.rmdir)

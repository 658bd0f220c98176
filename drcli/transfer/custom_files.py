"""Copies the racer's own files to the bucket and back; nothing is ever deleted."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from drcli.config import Settings
from drcli.errors import SettingsError
from drcli.rewriting import remedy_for, rewrite
from drcli.runs.inputs import custom_files_folder
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import open_bucket
from drcli.store.proof import Proof
from drcli.transfer.places import PLAN_PATIENCE_S

IGNORED = ("__pycache__", ".git", ".ipynb_checkpoints", ".DS_Store")
"""Files and folders that programs leave behind."""

BACKUP = ".bak"
"""End of the name of a file as it was before another one took its place."""


@dataclass(frozen=True)
class CustomFilesReport:
    """What was copied.

    Attributes:
        folder: The racer's folder.
        place: Its counterpart in the bucket, an s3:// address.
        copied: Names of the files that were copied, below both.
        unchanged: Names of those that were the same.
        refused: Names in the bucket that would be no files inside the folder.
    """

    folder: str
    place: str
    copied: list[str]
    unchanged: list[str]
    refused: list[str]


def upload_custom_files(
    settings: Settings, directory: Path, say: Callable[[str], None]
) -> CustomFilesReport:
    """Copy what lies in `custom_files/` of the working folder, or of the experiment.

    Raises:
        SettingsError: There is no such folder, or a file in it cannot be read.
        StorageError: The bucket cannot be written.
    """
    folder, bucket, place = _ends(settings, directory)
    if not folder.is_dir():
        raise SettingsError(
            f"{folder}: there is no such folder.",
            remedy="Make it and put reward_function.py, hyperparameters.json and "
            "model_metadata.json there, or let `dr init` do so.",
        )
    say(f"Uploading files to {place}")
    start = keys.folder(settings.custom_files_prefix)
    there = {info.key: info for info in bucket.list(start)}
    copied, unchanged = [], []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if not path.is_file() or set(IGNORED) & set(name.parts) or path.suffix == BACKUP:
            continue
        data, key = _read(path), start + name.as_posix()
        if Proof.of(data).holds(bucket, there.get(key)):
            unchanged.append(name.as_posix())
            continue
        bucket.put(key, data)
        copied.append(name.as_posix())
    return CustomFilesReport(str(folder), place, copied, unchanged, [])


def download_custom_files(
    settings: Settings, directory: Path, say: Callable[[str], None]
) -> CustomFilesReport:
    """Copy everything back; a file that was different stays beside the new one as `NAME.bak`.

    Raises:
        SettingsError: A file cannot be written.
        StorageError: The bucket cannot be read.
    """
    folder, bucket, place = _ends(settings, directory)
    say(f"Downloading files from {place}")
    start = keys.folder(settings.custom_files_prefix)
    copied, unchanged, refused = [], [], []
    for info in bucket.list(start):
        name = info.key.removeprefix(start)
        if not _is_inside(name):
            refused.append(name)
        elif write_file(folder / name, bucket.get(info.key)):
            copied.append(name)
        else:
            unchanged.append(name)
    return CustomFilesReport(str(folder), place, copied, unchanged, refused)


def write_file(path: Path, data: bytes) -> bool:
    """Write a file in one step and keep what was there before as `NAME.bak`.

    Returns:
        False when the file held the same.

    Raises:
        SettingsError: It cannot be written.
    """
    try:
        if path.is_file():
            if path.read_bytes() == data:
                return False
            shutil.copy2(path, path.with_name(path.name + BACKUP))
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise SettingsError(
            f"{path}: cannot be written ({e.strerror or e}).",
            remedy=remedy_for(e, path, f"Check that you may write {path.parent}."),
        ) from e
    rewrite(path, data)
    return True


def _ends(settings: Settings, directory: Path) -> tuple[Path, Bucket, str]:
    bucket = open_bucket(settings, directory, patience_s=PLAN_PATIENCE_S)
    place = f"s3://{bucket.name}/{settings.custom_files_prefix}"
    return custom_files_folder(settings, directory), bucket, place


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        raise SettingsError(
            f"{path}: cannot be read ({e.strerror or e}).", remedy="Check who may read it."
        ) from e


def _is_inside(name: str) -> bool:
    """Whether a name of the bucket is that of a file in the folder, and not of one around it."""
    parts = PurePosixPath(name).parts
    plain = bool(name) and not name.endswith("/") and "\\" not in name and "\0" not in name
    return plain and not name.startswith("/") and ".." not in parts

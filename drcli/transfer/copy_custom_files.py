"""Copies the racer's own files to the bucket and back. Deletes nothing."""

import errno
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, NoReturn

from drcli.base.errors import SettingsError
from drcli.base.files import is_left_behind, make_folder, read_regular, remedy_for, rewrite
from drcli.base.report import View, counted
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.run_config import CustomFilesConfig, StorageConfig
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.network_shape import own_files
from drcli.model.model_store import ModelStore
from drcli.model.verify import Checksums
from drcli.model.write_probe import prove_writing

BACKUP = ".bak"


@dataclass(frozen=True)
class CustomFilesReport:
    """The result of copying the racer's files."""

    folder: Annotated[str, "The racer's folder."]
    place: Annotated[str, "The folder in the bucket, an s3:// address."]
    copied: Annotated[list[str], "Names of the files that were copied, below both."]
    unchanged: Annotated[list[str], "Names of the files that were the same."]
    refused: Annotated[
        list[str],
        "Names that were not copied: objects that are not a valid path in the folder, "
        "and files whose name is not UTF-8.",
    ]

    def view(self, *, up: bool) -> View:
        place = self.place if up else self.folder
        unchanged = f", {len(self.unchanged)} unchanged" if self.unchanged else ""
        return [*self.copied, f"{counted(len(self.copied), 'file')} copied to {place}{unchanged}."]


def upload_custom_files(
    config: CustomFilesConfig, storage: StorageConfig, say: Callable[[str], None]
) -> CustomFilesReport:
    """Copy `custom_files/` to the bucket.

    Raises:
        SettingsError: The folder or a file cannot be read.
        StorageError: The bucket cannot be written; nothing was copied.
    """
    folder, bucket = config.folder, open_bucket(storage, patience_s=COMMAND_PATIENCE_S)
    place = f"s3://{bucket.name}/{config.prefix}"
    if not folder.is_dir():
        raise SettingsError(
            f"{folder}: this folder does not exist.",
            remedy="Create it and put reward_function.py, hyperparameters.json and "
            "model_metadata.json there, or run `dr init`.",
        )
    say(f"Uploading files to {place}")
    start = keys.folder(config.prefix)
    there = {info.key: info for info in bucket.list(start)}
    copied: list[str] = []
    unchanged, refused = [], []
    for path in sorted(_files(folder)):
        name = path.relative_to(folder).as_posix()
        readable = os.fsencode(name).decode(errors="backslashreplace")
        if readable != name:  # Linux takes any bytes, S3 only UTF-8
            refused.append(readable)
            continue
        data, key = _read(path), start + name
        if Checksums.of(data).matches(bucket, there.get(key)):
            unchanged.append(name)
            continue
        if not copied:
            prove_writing(ModelStore(bucket, config.prefix), deletes=False)
        bucket.put(key, data)
        copied.append(name)
    return CustomFilesReport(str(folder), place, copied, unchanged, refused)


def download_custom_files(
    config: CustomFilesConfig, storage: StorageConfig, say: Callable[[str], None]
) -> CustomFilesReport:
    """Keeps an old file that differs as `NAME.bak`."""
    folder, bucket = config.folder, open_bucket(storage, patience_s=COMMAND_PATIENCE_S)
    place = f"s3://{bucket.name}/{config.prefix}"
    say(f"Downloading files from {place}")
    start = keys.folder(config.prefix)
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


def write_own_files(model: ModelStore, folder: Path) -> list[str]:
    """Copy the last checkpoint's files to the racer's folder; returns changed paths."""
    files = {
        keys.REWARD_FUNCTION_FILE: model.bucket.get(keys.reward_function(model.prefix)),
        **own_files(model, str(CheckpointStore(model).pointed())),
    }
    return [str(folder / name) for name, data in files.items() if write_file(folder / name, data)]


def write_file(path: Path, data: bytes) -> bool:
    """Write in one step, keep the old file as `NAME.bak`; False if equal."""
    try:
        if path.is_file():
            if path.read_bytes() == data:
                return False
            shutil.copy2(path, path.with_name(path.name + BACKUP))
        make_folder(path.parent)
    except OSError as e:
        raise SettingsError(
            f"{path}: cannot be written ({e.strerror or e}).",
            remedy=remedy_for(e, path, f"Check that you can write {path.parent}."),
        ) from e
    rewrite(path, data)
    return True


def _files(folder: Path) -> Iterator[Path]:
    for parent, below, names in os.walk(folder, onerror=_refuse):
        below[:] = [name for name in below if not is_left_behind(name)]
        for name in names:
            path = Path(parent, name)
            if not is_left_behind(name) and path.suffix != BACKUP and _is_file(path):
                yield path


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError as e:
        if e.errno in (errno.ENOENT, errno.ENOTDIR, errno.ELOOP):
            return False
        _refuse(e)


def _read(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as e:
        _refuse(e, path)


def _refuse(error: OSError, path: Path | None = None) -> NoReturn:
    raise SettingsError(
        f"{path or error.filename}: cannot be read ({error.strerror or error}).",
        remedy="Check the permissions of the file.",
    ) from error


def _is_inside(name: str) -> bool:
    parts = PurePosixPath(name).parts
    plain = "\\" not in name and "\0" not in name
    return plain and not name.startswith("/") and ".." not in parts

"""Packs a model, or its logs, into one archive."""

import io
import tarfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.exchange.log_places import KINDS, log_folder
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectInfo, ObjectMissing
from drcli.store.model_traces import traces_of

_STEPS = ("-simtrace/", "/mp4/", "/video.mp4")
"""Traces and videos are large, and no import reads them."""


@dataclass(frozen=True)
class PackedModel:
    model: str
    file: str
    files: int
    size_bytes: int


def pack_model(
    bucket: Bucket,
    prefix: str,
    path: Path,
    *,
    traces: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> PackedModel:
    """Write a model as `.tar.gz`, which `dr-import` and consoles read.

    Raises:
        SettingsError: There is none, or the file cannot be written.
        StorageError: The bucket does not answer.
    """
    folder = keys.folder(prefix)
    own = [info for info in traces_of(bucket, prefix).objects if info.key.startswith(folder)]
    if not traces:
        own = [info for info in own if not any(part in f"/{info.key}" for part in _STEPS)]
    if not own:
        raise _nothing(bucket, prefix, "files")
    own.sort(key=lambda info: info.key)
    with _archive(path) as archive:
        count = _add_objects(archive, bucket, own, folder, progress)
    return PackedModel(prefix, str(path), count, path.stat().st_size)


def pack_logs(
    bucket: Bucket,
    directory: Path,
    prefix: str,
    path: Path,
    progress: Callable[[str], None] = lambda text: None,
) -> PackedModel:
    """Pack the logs of this machine, else those in the bucket.

    Raises:
        SettingsError: There are none, or the file cannot be written.
        StorageError: The bucket does not answer.
    """
    if not keys.is_valid_prefix(prefix):
        raise _nothing(bucket, prefix, "logs")
    here = {
        f"{kind}/{file.name}": file
        for kind in KINDS
        for file in sorted(_files(log_folder(directory, prefix, kind)))
    }
    folder = f"{keys.folder(prefix)}logs/"
    stored = [info for info in bucket.list(folder) if info.key.removeprefix(folder) not in here]
    if not here and not stored:
        raise _nothing(bucket, prefix, "logs")
    with _archive(path) as archive:
        for name, file in here.items():
            archive.add(file, f"logs/{name}", recursive=False)
        count = _add_objects(archive, bucket, stored, keys.folder(prefix), progress)
    return PackedModel(prefix, str(path), len(here) + count, path.stat().st_size)


def _files(folder: Path) -> Iterator[Path]:
    if folder.is_dir():
        for path in folder.iterdir():
            if path.is_file() and not path.is_symlink():
                yield path


@contextmanager
def _archive(path: Path) -> Iterator[tarfile.TarFile]:
    try:
        with tarfile.open(path, "w:gz", compresslevel=1, dereference=False) as archive:
            yield archive
    except OSError as error:
        path.unlink(missing_ok=True)
        raise SettingsError(
            f"{path} cannot be written: {error.strerror or error}.",
            remedy="Make room on the disk, then try again.",
        ) from error
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _add_objects(
    archive: tarfile.TarFile,
    bucket: Bucket,
    objects: Iterable[ObjectInfo],
    folder: str,
    progress: Callable[[str], None],
) -> int:
    every = list(objects)
    count = 0
    for number, info in enumerate(every):
        if number % 20 == 0:
            progress(f"{number} of {len(every)} files")
        try:
            data = bucket.get(info.key)
        except ObjectMissing:
            continue  # a training deletes its older checkpoints
        member = tarfile.TarInfo(info.key.removeprefix(folder))
        member.size, member.mtime = len(data), int(info.modified.timestamp())
        archive.addfile(member, io.BytesIO(data))
        count += 1
    return count


def _nothing(bucket: Bucket, prefix: str, what: str) -> SettingsError:
    return SettingsError(
        f"s3://{bucket.name}/{prefix} has no {what}.",
        remedy="`dr-list-models` lists all models.",
    )

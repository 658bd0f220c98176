"""Reads the files of a model to import, from a folder or an archive, into memory."""

import lzma
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from drcli.base.errors import SettingsError
from drcli.base.problems import shown

Files = dict[str, bytes]
"""The files of a model by their names below its folder, with slashes."""

MOST_BYTES = 1024**3
"""Size of a model that can be imported. Source: deepracer-on-aws, its import page."""

MOST_FILES = 1_000
"""Its importer copies no more than one page of a list of objects."""

_LARGEST_ARCHIVE_FILES = 10_000
_SKIPPED_NAMES = frozenset({".ds_store", "._.ds_store", "thumbs.db", "desktop.ini"})
_SKIPPED_ENDS = (".gz", ".zip")
_SKIPPED_FOLDERS = frozenset({"__MACOSX"})
_TAR_ENDS = (".tar.gz", ".tgz", ".tar", ".tar.bz2", ".tar.xz")

_DAMAGE = (
    tarfile.TarError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
)
"""What Python's readers raise for damaged, encrypted and unknown archives."""

ROOT_FILE = "model_metadata.json"
"""A folder with this file is the root of a model."""


def read_package(source: Path) -> Files:
    """Read the files of a model.

    Files that the importer does not want, such as archives inside, are left out. An archive may
    hold the files in one folder. Nothing is written to disk.

    Raises:
        SettingsError: There is no such folder or archive, it is damaged or too large, or it
            contains something else than files and folders.
    """
    try:
        if source.is_dir():
            files = _collect(_folder(source), source)
        elif source.is_file():
            files = _collect(_archive(source), source)
        else:
            raise SettingsError(
                f"{source} does not exist.",
                remedy="Give the folder or archive of a model, as `dr-export droa` writes it.",
            )
    except OSError as e:
        raise SettingsError(
            f"{source} cannot be read ({e.strerror or e}).",
            remedy="Check that you can read it with all files inside.",
        ) from e
    if not files:
        raise SettingsError(
            f"{source} contains no files to import.",
            remedy="Give the folder or archive of a model, as `dr-export droa` writes it.",
        )
    return _from_root(files)


def is_wanted(name: str) -> bool:
    """Whether a file belongs to an import; archives and files of file managers do not."""
    path = PurePosixPath(name)
    return (
        path.name.casefold() not in _SKIPPED_NAMES
        and not path.name.casefold().endswith(_SKIPPED_ENDS)
        and not _SKIPPED_FOLDERS.intersection(path.parts)
    )


def _collect(found: Iterator[tuple[str, int, bytes]], source: Path) -> Files:
    files: Files = {}
    total = 0
    for name, _, data in found:
        if name in files:
            raise _bad(source, f"it contains {shown(name)} twice")
        files[name] = data
        total += len(data)
        if total > MOST_BYTES:
            raise _too_large(source)
    return files


def _folder(source: Path) -> Iterator[tuple[str, int, bytes]]:
    for path in sorted(source.rglob("*")):
        name = path.relative_to(source).as_posix()
        if path.is_dir() or not is_wanted(name):
            continue
        if not path.is_file():
            raise _bad(source, f"{shown(name)} is not a file")
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise _too_large(source)
        yield name, size, path.read_bytes()


def _archive(source: Path) -> Iterator[tuple[str, int, bytes]]:
    try:
        if zipfile.is_zipfile(source):
            yield from _zip(source)
        elif tarfile.is_tarfile(source):
            yield from _tar(source)
        else:
            raise _bad(source, f"it is neither a folder nor an archive ({', '.join(_TAR_ENDS)})")
    except _DAMAGE as e:
        raise _bad(source, "the archive is damaged or encrypted") from e
    except OSError as e:
        if e.errno is None:  # gzip and bz2 report damage so
            raise _bad(source, "the archive is damaged") from e
        raise


def _tar(source: Path) -> Iterator[tuple[str, int, bytes]]:
    left = MOST_BYTES
    with tarfile.open(source) as archive:
        for number, member in enumerate(archive):
            _count(source, number)
            if member.isdir():
                continue
            name = _safe(source, member.name)
            if not member.isreg():
                raise _bad(source, f"{shown(name)} is a link or a device")
            left -= member.size
            if left < 0:
                raise _too_large(source)
            file = archive.extractfile(member)
            if file is not None and is_wanted(name):
                yield name, member.size, file.read()


def _zip(source: Path) -> Iterator[tuple[str, int, bytes]]:
    left = MOST_BYTES
    with zipfile.ZipFile(source) as archive:
        for number, member in enumerate(archive.infolist()):
            _count(source, number)
            if member.is_dir():
                continue
            name = _safe(source, member.filename)
            if (member.external_attr >> 16) & 0o170000 == 0o120000:
                raise _bad(source, f"{shown(name)} is a link or a device")
            with archive.open(member) as file:
                data = file.read(left + 1)  # the size in the list may be a lie
            left -= len(data)
            if left < 0:
                raise _too_large(source)
            if is_wanted(name):
                yield name, len(data), data


def _count(source: Path, number: int) -> None:
    if number >= _LARGEST_ARCHIVE_FILES:
        raise _bad(source, f"it contains more than {_LARGEST_ARCHIVE_FILES:,} files")


def _safe(source: Path, name: str) -> str:
    """A member's name; one that leads out of the archive is refused."""
    path = PurePosixPath(name.replace("\\", "/"))
    leads_out = path.is_absolute() or ".." in path.parts or ":" in name or "\0" in name
    if leads_out or not path.parts or not name.isprintable():
        raise _bad(source, f"{shown(name)} is not a name inside the archive")
    return path.as_posix()


def _from_root(files: Files) -> Files:
    """The files by their names below the root of the model.

    An archive may hold it in one folder, as the models that DeepRacer on AWS exports do.
    """
    if ROOT_FILE in files:
        return files
    tops = {name.partition("/")[0] for name in files}
    top = next(iter(tops))
    if len(tops) == 1 and f"{top}/{ROOT_FILE}" in files:
        return {name.partition("/")[2]: data for name, data in files.items()}
    return files


def _bad(source: Path, reason: str) -> SettingsError:
    return SettingsError(
        f"{source} cannot be imported: {reason}.",
        remedy="Give the folder or archive of a model, as `dr-export droa` writes it.",
    )


def _too_large(source: Path) -> SettingsError:
    return SettingsError(
        f"{source} is too large: DeepRacer on AWS imports models up to 1 GB.",
        remedy="Leave out logs, videos and older checkpoints.",
    )

"""Reads the files of a model to import."""

from io import BytesIO
from pathlib import Path

from drcli.base.archive import read_packed, unpack_archive
from drcli.base.errors import SettingsError, shown
from drcli.base.files import is_left_behind
from drcli.convert.droa_rules import MOST_BYTES

Files = dict[str, bytes]

_SKIPPED_ENDS = (".gz", ".zip")

ROOT_FILE = "model_metadata.json"


def read_package(source: Path) -> Files:
    """Read a folder or an archive, without unwanted files.

    Raises:
        SettingsError: It is missing, damaged or too large.
    """
    try:
        if source.is_dir():
            files = _folder(source)
        elif source.is_file():
            packed = BytesIO(read_packed(source))
            files = unpack_archive(packed, str(source), wanted=is_wanted)
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
    return not is_left_behind(name) and not name.casefold().endswith(_SKIPPED_ENDS)


def _folder(source: Path) -> Files:
    files: Files = {}
    left = MOST_BYTES
    for path in sorted(source.rglob("*")):
        name = path.relative_to(source).as_posix()
        if path.is_dir() or not is_wanted(name):
            continue
        if not path.is_file():
            raise _bad(source, f"{shown(name)} is not a file")
        left -= path.stat().st_size
        if left < 0:
            raise SettingsError(
                f"{source} is too large: DeepRacer on AWS imports models up to 1 GB.",
                remedy="Leave out logs, videos and older checkpoints.",
            )
        files[name] = path.read_bytes()
    return files


def _from_root(files: Files) -> Files:
    """It may be one folder of an archive."""
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

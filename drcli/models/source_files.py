"""The files of a model to import: in a folder, file, archive or bucket."""

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.left_behind import is_left_behind
from drcli.base.problems import shown
from drcli.base.regular_file import read_regular
from drcli.config.bucket_config import TransferConfig
from drcli.models.transfer_buckets import COPY_PATIENCE_S, parse_url, source_bucket
from drcli.store import keys

MOST_FILES = 100_000
LARGEST_BYTES = 1 << 30
"""Of one file; the reference's largest has about 230 MB."""

_BESIDE = (
    keys.MODEL_METADATA_FILE,
    keys.HYPERPARAMETERS_FILE,
    f"ip/{keys.HYPERPARAMETERS_FILE}",
    keys.REWARD_FUNCTION_FILE,
    "training_params.yaml",
)
_PART = re.compile(r"\.(index|meta|data-\d{5}-of-\d{5})$")
_NO_MODEL = {
    ".pkl": "a Python pickle",
    ".pickle": "a Python pickle",
    ".pt": "a file of PyTorch",
    ".pth": "a file of PyTorch",
    ".zip": "a ZIP archive, such as Stable-Baselines3 writes",
    ".h5": "a file of Keras",
    ".tflite": "a TensorFlow Lite model, whose weights may be rounded",
    ".xml": "a model of OpenVINO, whose weights may be rounded",
    ".bin": "a model of OpenVINO, whose weights may be rounded",
}


@dataclass(frozen=True)
class SourceFiles:
    """`fixed` is the file that the racer named."""

    origin: str
    sizes: Mapping[str, int]
    _read: Callable[[str], bytes]
    fixed: str | None = None
    is_archive: bool = False
    is_bucket: bool = False

    def read(self, name: str) -> bytes:
        """Read a file.

        Raises:
            SettingsError: It is too large, or cannot be read.
            StorageError: The bucket cannot be read.
        """
        if self.sizes[name] > LARGEST_BYTES:
            raise SettingsError(
                f"{self.place(name)} has {self.sizes[name]:,} bytes, more than any file of a model "
                "has.",
                remedy="Name a model of the reference simulator.",
            )
        return self._read(name)

    def place(self, name: str) -> str:
        return f"{self.origin}: {shown(name)}" if self.is_archive else f"{self.origin}/{name}"


def open_source(ends: TransferConfig, source: str, *, local: bool) -> SourceFiles:
    """Find the files at a path or s3:// address.

    Raises:
        SettingsError: It is missing, or cannot be a model.
        StorageError: The bucket cannot be read.
    """
    if source.casefold().startswith("s3://"):
        return _in_bucket(ends, source, local=local)
    path = Path(source).expanduser()
    try:
        if path.is_dir():
            return files_in_folder(path)
        if path.is_file() and _is_archive(path):
            return _in_archive(path)
        return _single(path)
    except OSError as e:
        raise _unreadable(path, e) from e


def _in_bucket(ends: TransferConfig, source: str, *, local: bool) -> SourceFiles:
    name, prefix = parse_url(source, "SOURCE")
    bucket = source_bucket(ends, name, local=local, patience_s=COPY_PATIENCE_S)
    folder = keys.folder(prefix)
    sizes = {
        info.key.removeprefix(folder): info.size_bytes
        for info in bucket.list(folder)
        if not is_left_behind(info.key.removeprefix(folder))
    }
    if not sizes:
        raise SettingsError(
            f"There is nothing at s3://{name}/{prefix}.",
            remedy="Correct the address"
            + ("." if local else ", or add -L if the bucket is at the local server."),
        )
    return SourceFiles(
        f"s3://{name}/{prefix}", sizes, lambda key: bucket.get(folder + key), is_bucket=True
    )


def files_in_folder(path: Path) -> SourceFiles:
    """Without hidden folders and leftovers of programs.

    Raises:
        OSError: It cannot be listed.
        SettingsError: It has too many files for a model.
    """
    sizes: dict[str, int] = {}

    def refuse(error: OSError) -> None:
        raise error

    for parent, below, names in os.walk(path, onerror=refuse):
        below[:] = sorted(name for name in below if not name.startswith("."))
        for name in names:
            file = Path(parent, name)
            if file.is_file() and not is_left_behind(name):
                sizes[file.relative_to(path).as_posix()] = file.stat().st_size
        if len(sizes) > MOST_FILES:
            raise SettingsError(
                f"{path} has more than {MOST_FILES:,} files.", remedy="Name the folder of a model."
            )
    return SourceFiles(str(path), sizes, lambda name: _content(path / name))


def _is_archive(path: Path) -> bool:
    """The .zip of Stable-Baselines3 is a pickle."""
    from drcli.formats.archive import ENDINGS
    from drcli.formats.pickles import is_pickle

    name = path.name.casefold()
    if name.endswith(".zip"):
        data = read_regular(path)
        return data.startswith(b"PK") and not is_pickle(data)
    return name.endswith(ENDINGS)


def _in_archive(path: Path) -> SourceFiles:
    from drcli.formats.archive import read_archive

    members = read_archive(path)
    sizes = {name: len(data) for name, data in members.items()}
    return SourceFiles(str(path), sizes, members.__getitem__, is_archive=True)


def _single(path: Path) -> SourceFiles:
    stem = path.with_name(_PART.sub("", path.name))
    is_checkpoint = stem.with_name(f"{stem.name}.index").is_file() or stem.name != path.name
    if not path.exists() and not is_checkpoint:
        raise SettingsError(
            f"{path} does not exist.",
            remedy="Name a file, a folder or an archive on this machine, or s3://bucket/prefix.",
        )
    if not is_checkpoint and path.suffix.casefold() not in (".pb", ".onnx"):
        what = _NO_MODEL.get(path.suffix.casefold(), "not a file of a model")
        if path.exists() and not path.is_file():
            what = "not an ordinary file"
        raise SettingsError(
            f"{path} is {what}, so it cannot be imported.",
            remedy="Name a frozen graph (.pb), a TensorFlow checkpoint (.index), an .onnx of "
            "`dr-export onnx`, an archive (.tar.gz) or a model's folder. Other policies can be "
            "exported to ONNX and raced with `dr-evaluate --model FILE`.",
        )
    folder = path.parent
    top = folder.resolve().parent if folder.resolve().name == "model" else folder
    paths = {name: top / name for name in _BESIDE} if top != folder else {}
    paths = {name: file for name, file in paths.items() if file.is_file()}
    inside = "model/" if top != folder else ""
    beside = [*_BESIDE, path.name, f"{path.stem}.{keys.MODEL_METADATA_FILE}"]
    if is_checkpoint:
        ends = folder.iterdir() if folder.is_dir() else ()
        beside += [file.name for file in ends if _PART.sub("", file.name) == stem.name]
    paths |= {inside + name: folder / name for name in beside if (folder / name).is_file()}
    sizes = {name: file.stat().st_size for name, file in paths.items()}
    fixed = inside + (stem.name if is_checkpoint else path.name)
    return SourceFiles(str(top), sizes, lambda name: _content(paths[name]), fixed)


def _content(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as e:
        raise _unreadable(path, e) from e


def _unreadable(path: Path, error: OSError) -> SettingsError:
    return SettingsError(
        f"{error.filename or path}: cannot be read ({error.strerror or error}).",
        remedy="Check its name and permissions.",
    )

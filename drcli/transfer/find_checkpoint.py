"""Finds the checkpoint to import, and the files that belong to it."""

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal, NoReturn

from drcli.base.archive import ENDINGS, is_pickle, read_archive
from drcli.base.errors import SettingsError, shown
from drcli.base.files import is_left_behind, read_regular
from drcli.base.json_record import RecordError
from drcli.config.run_config import TransferConfig
from drcli.model import keys
from drcli.records.checkpoint import CheckpointName
from drcli.records.scores import Scores
from drcli.transfer import minio_folder
from drcli.transfer.transfer_buckets import COPY_PATIENCE_S, parse_url, source_bucket

# The files of a model to import: in a folder, file, archive or bucket.


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
    """Without hidden folders and leftovers of programs; objects of MinIO count as files.

    Raises:
        OSError: It cannot be listed.
        SettingsError: It has too many files for a model, or is itself an object.
    """
    if (path / minio_folder.META).is_file():
        raise SettingsError(
            f"{path} is one object of MinIO.", remedy="Name the folder of its model instead."
        )
    sizes: dict[str, int] = {}
    objects = set()

    def refuse(error: OSError) -> None:
        raise error

    for parent, below, names in os.walk(path, onerror=refuse):
        if len(sizes) > MOST_FILES:
            raise SettingsError(
                f"{path} has more than {MOST_FILES:,} files.", remedy="Name the folder of a model."
            )
        if minio_folder.META in names:
            below.clear()
            name = Path(parent).relative_to(path).as_posix()
            size = minio_folder.size_of(Path(parent))
            if size is not None and not is_left_behind(name):
                sizes[name] = size
                objects.add(name)
            continue
        below[:] = sorted(name for name in below if name[0] != "." or _is_object(parent, name))
        for name in names:
            file = Path(parent, name)
            if file.is_file() and not is_left_behind(name):
                sizes[file.relative_to(path).as_posix()] = file.stat().st_size

    def read(name: str) -> bytes:
        is_object = name in objects
        return minio_folder.read(path / name) if is_object else _content(path / name)

    return SourceFiles(str(path), sizes, read)


def _is_object(parent: str, name: str) -> bool:
    return Path(parent, name, minio_folder.META).is_file()


def _is_archive(path: Path) -> bool:
    """The .zip of Stable-Baselines3 is a pickle."""
    name = path.name.casefold()
    if name.endswith(".zip"):
        data = read_regular(path)
        return data.startswith(b"PK") and not is_pickle(data)
    return name.endswith(ENDINGS)


def _in_archive(path: Path) -> SourceFiles:
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


Form = Literal["TensorFlow checkpoint", "frozen graph", "ONNX"]
Wanted = Literal["last", "best"] | int

_INDEX, _DATA, _META = ".index", re.compile(r"\.data-(\d{5})-of-(\d{5})$"), ".meta"
_GRAPH = re.compile(r"(?:^|.*[^0-9])(\d{1,9})\.(?:pb|onnx)$")
_ARCHIVE_NUMBER = re.compile(r"-chk(\d{1,9})\.(?:tar(?:\.\w+)?|tgz|zip)$")
_STATE = re.compile(r'^model_checkpoint_path:\s*"(?:[^"]*/)?([^"/]+)"', re.MULTILINE)

_LARGEST_NUMBER = 10**9

_MODEL_FOLDERS = ("model", "agent")


@dataclass(frozen=True)
class Candidate:
    """A checkpoint in one form; an index precedes its data files."""

    form: Form
    files: tuple[str, ...]
    folder: str
    name: CheckpointName
    title: str
    missing: str | None = None

    @property
    def root(self) -> str:
        parent, _, last = self.folder.rpartition("/")
        root = parent if last in _MODEL_FOLDERS else self.folder
        return f"{root}/" if root else ""


def find_checkpoint(source: SourceFiles, wanted: Wanted | None) -> Candidate:
    """The checkpoint to import, by default the last.

    Raises:
        SettingsError: It is missing, ambiguous, incomplete, or ours.
    """
    if source.fixed is not None and wanted is not None:
        raise SettingsError(
            f"{source.place(source.fixed)} is a single checkpoint, so none can be chosen.",
            remedy="Name the folder of the model instead, or leave out -b and --checkpoint.",
        )
    found = _candidates(source)
    if source.fixed is not None:
        found = [each for each in found if each.title == source.fixed] or found
    if not found:
        _refuse_none(source)
    found = _of_one_model(source, found)
    chosen = _chosen(source, found, wanted)
    if chosen.missing is not None:
        raise SettingsError(
            f"{source.place(chosen.title)} is incomplete: {chosen.missing} is missing.",
            remedy="Copy all files of the checkpoint, or choose another with --checkpoint N.",
        )
    return chosen


def belonging(source: SourceFiles, chosen: Candidate, name: str) -> str | None:
    """The file of this name nearest to a checkpoint, or None.

    First `model.<name>` beside `model.pb`, as exports write it, then outwards.
    """
    own = f"{PurePosixPath(chosen.title).with_suffix('')}.{name}"
    if own in source.sizes:
        return own
    inside = f"{chosen.folder}/{name}" if chosen.folder else name
    if inside in source.sizes:
        return inside
    below = [
        file
        for file in source.sizes
        if file.startswith(chosen.root) and PurePosixPath(file).name == name
    ]
    return min(below, key=lambda file: (file.count("/"), file), default=None)


def _candidates(source: SourceFiles) -> list[Candidate]:
    found = []
    for file in sorted(source.sizes):
        if file.endswith(_INDEX):
            found.append(_bundle(source, file.removesuffix(_INDEX)))
        elif file.endswith((".pb", ".onnx")) and not file.endswith("saved_model.pb"):
            found.append(_graph(source, file))
    known = {each.title for each in found}
    for file in sorted(source.sizes):
        stem = _DATA.sub("", file)
        if stem != file and stem not in known:  # a checkpoint without its index
            known.add(stem)
            found.append(_bundle(source, stem))
    return found


def _bundle(source: SourceFiles, stem: str) -> Candidate:
    data = {
        (int(match[1]), int(match[2])): file
        for file in source.sizes
        if file.startswith(stem) and (match := _DATA.match(file, len(stem)))
    }
    count = max((of for _, of in data), default=1)
    files, missing = [stem + _INDEX], None
    if stem + _INDEX not in source.sizes:
        missing = PurePosixPath(stem + _INDEX).name
    for shard in range(min(count, len(data) + 1)):
        file = data.get((shard, count))
        if file is None:
            missing = missing or PurePosixPath(f"{stem}.data-{shard:05d}-of-{count:05d}").name
        else:
            files.append(file)
    folder, _, last = stem.rpartition("/")
    name = _small(CheckpointName.parse(last)) or CheckpointName(0, 0)
    return Candidate("TensorFlow checkpoint", tuple(files), folder, name, stem, missing)


def _graph(source: SourceFiles, file: str) -> Candidate:
    folder, _, last = file.rpartition("/")
    number = _GRAPH.fullmatch(last)
    if number is None and source.is_archive:
        number = _ARCHIVE_NUMBER.search(source.origin)
    name = CheckpointName(0 if number is None else int(number[1]), 0)
    form: Form = "ONNX" if file.endswith(".onnx") else "frozen graph"
    return Candidate(form, (file,), folder, name, file)


def _small(name: CheckpointName | None) -> CheckpointName | None:
    if name is None or max(name.number, name.steps) >= _LARGEST_NUMBER:
        return None
    return name


def _refuse_none(source: SourceFiles) -> NoReturn:
    ours = [file for file in source.sizes if file.endswith(".safetensors")]
    if ours:
        refuse_ours(source)
    some = ", ".join(shown(file) for file in sorted(source.sizes)[:3]) or "no files"
    raise SettingsError(
        f"{source.origin} has no model of the reference simulator; it has {some}.",
        remedy="Name a frozen graph (model_N.pb), a TensorFlow checkpoint (.index and .data-*), an "
        ".onnx of `dr-export onnx`, or the folder or archive of a model.",
    )


class OwnModel(SettingsError):
    """It was trained by drcli, so it is only copied."""


def refuse_ours(source: SourceFiles) -> NoReturn:
    kind = SettingsError if source.is_bucket else OwnModel
    raise kind(
        f"{source.origin} is a model of drcli already.",
        remedy=f"Copy it with `dr-download-model -s {source.origin} -t PREFIX`.",
    )


def _of_one_model(source: SourceFiles, found: list[Candidate]) -> list[Candidate]:
    """TensorFlow's come first: frozen graphs lack the spread of continuous actions."""
    bundles = [each for each in found if each.form == "TensorFlow checkpoint"]
    graphs = [each for each in found if each.form == "frozen graph"]
    best = bundles or graphs or found
    folders = sorted({each.folder for each in best})
    if len(folders) > 1:
        named = [folder for folder in folders if folder.rpartition("/")[2] == "model"]
        if len(named) != 1:
            what = "frozen graphs" if not bundles else "models"
            listed = ", ".join(shown(folder or ".") for folder in folders[:4])
            raise SettingsError(
                f"{source.origin} has several {what}, in {listed}.",
                remedy="Name the one to import.",
            )
        folders = named
    if any(
        file.startswith(f"{folders[0]}/" if folders[0] else "") and file.endswith(".safetensors")
        for file in source.sizes
    ):
        refuse_ours(source)
    inside = [each for each in found if each.folder == folders[0]]
    return [each for each in inside if each in best] + [each for each in inside if each not in best]


def _chosen(source: SourceFiles, found: Sequence[Candidate], wanted: Wanted | None) -> Candidate:
    if isinstance(wanted, int):
        same = [each for each in found if each.name.number == wanted]
        if not same:
            raise SettingsError(
                f"{source.origin} has no checkpoint {wanted}; there are {_numbers(found)}.",
                remedy="Choose one of them with --checkpoint N.",
            )
        return _one(source, same)
    if wanted == "best":
        scores = _scores(source, found[0].folder)
        if scores is None:
            raise SettingsError(
                f"{source.origin} has no deepracer_checkpoints.json that says which checkpoint is "
                f"the best; there are {_numbers(found)}.",
                remedy="Choose one of them with --checkpoint N.",
            )
        return _named(source, found, scores.best_checkpoint.name, "best")
    if len(found) == 1:
        return found[0]
    pointed = _last(source, found[0].folder)
    if pointed is not None:
        return _named(source, found, pointed, "last")
    newest = max(each.name.number for each in found)
    return _one(source, [each for each in found if each.name.number == newest])


def _named(source: SourceFiles, found: Sequence[Candidate], name: str, which: str) -> Candidate:
    parsed = CheckpointName.parse(name)
    exact = [each for each in found if each.title.rpartition("/")[2] == name]
    number = None if parsed is None else parsed.number
    same = exact or [each for each in found if each.name.number == number]
    if not same:
        raise SettingsError(
            f"{source.origin} names {shown(name)} as its {which} checkpoint, but has only "
            f"{_numbers(found)}.",
            remedy="Choose one of them with --checkpoint N.",
        )
    chosen = _one(source, same)
    if chosen.form != "TensorFlow checkpoint" and parsed is not None and _small(parsed):
        return Candidate(chosen.form, chosen.files, chosen.folder, parsed, chosen.title)
    return chosen


def _one(source: SourceFiles, same: Sequence[Candidate]) -> Candidate:
    whole = [each for each in same if each.missing is None] or list(same)
    alike = [each for each in whole if each.form == whole[0].form]
    if len(alike) > 1:
        listed = " and ".join(shown(each.title) for each in alike[:2])
        raise SettingsError(
            f"{source.origin} has more than one model: {listed}.",
            remedy="Name the file to import, or choose one with --checkpoint N.",
        )
    return alike[0]


def _numbers(found: Iterable[Candidate]) -> str:
    numbers = sorted({each.name.number for each in found})
    return f"checkpoint{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _scores(source: SourceFiles, folder: str) -> Scores | None:
    data = _beside(source, folder, "deepracer_checkpoints.json")
    with suppress(RecordError):
        return None if data is None else Scores.decode(data)
    return None


def _last(source: SourceFiles, folder: str) -> str | None:
    scores = _scores(source, folder)
    if scores is not None:
        return scores.last_checkpoint.name
    pointer = _beside(source, folder, ".coach_checkpoint")
    if pointer is not None and CheckpointName.parse(text := pointer.decode(errors="replace")):
        return text.strip()
    state = _beside(source, folder, "checkpoint")
    named = None if state is None else _STATE.search(state.decode(errors="replace"))
    return None if named is None else named[1]


def _beside(source: SourceFiles, folder: str, name: str) -> bytes | None:
    file = f"{folder}/{name}" if folder else name
    if file not in source.sizes or source.sizes[file] > 1 << 20:
        return None
    return source.read(file)

"""Finds and reads a policy's file and metadata."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NoReturn

from drcli.base.archive import ENDINGS, is_pickle, read_archive
from drcli.base.errors import SettingsError, few, shown
from drcli.base.files import read_regular
from drcli.base.json_record import Fingerprint
from drcli.model.files.model_metadata import ModelMetadata

Form = Literal["pb", "onnx", "openvino", "tflite"]
"""Frozen TensorFlow graph, ONNX, OpenVINO's pair, TensorFlow Lite."""

METADATA = "model_metadata.json"

LARGEST_BYTES = 1 << 30
"""The reference's largest takes 230 MB."""

DOCUMENTED = "`dr docs formats` says how policies of other programs come in"

_FORMS: dict[str, Form] = {
    ".pb": "pb",
    ".onnx": "onnx",
    ".xml": "openvino",
    ".bin": "openvino",
    ".tflite": "tflite",
}
_KINDS = ".pb, .onnx, .xml (with its .bin), .tflite or a car's .tar.gz"
_PICKLES = (".pt", ".pth", ".pkl", ".pickle")


@dataclass(frozen=True)
class PolicyFile:
    """A policy's file; `weights` is the `.bin` of OpenVINO's pair, `sha256` is of both."""

    form: Form
    data: bytes
    weights: bytes
    origin: str
    metadata: ModelMetadata
    metadata_origin: str
    sha256: str


def read_policy_file(path: Path, metadata: Path | None = None) -> PolicyFile:
    """Read a policy's file.

    Its metadata is the given file, or in the archive, or beside it as `NAME.model_metadata.json` or
    `model_metadata.json`.

    Raises:
        SettingsError: File or metadata is missing or wrong, or no engine runs it.
    """
    name = path.name.casefold()
    if name.endswith(_PICKLES) or (name.endswith(".zip") and is_pickle(_read(path))):
        _refuse_pickle(path)
    weights = b""
    beside: tuple[str, bytes] | None = None
    if name.endswith(ENDINGS):
        form: Form = "pb"
        origin, data, beside = _from_archive(path)
    elif path.suffix.casefold() in _FORMS:
        form, origin = _FORMS[path.suffix.casefold()], str(path)
        if form == "openvino":
            origin = str(path.with_suffix(".xml"))
            weights = _read(path.with_suffix(".bin"))
        data = _read(Path(origin))
    elif not path.exists():
        raise SettingsError(f"{path} does not exist.", remedy="Correct the path.")
    else:
        raise SettingsError(
            f"{path} is not the file of a policy that can drive here.",
            remedy=f"Name a file of the form {_KINDS}; for a checkpoint in the bucket, set "
            "DR_LOCAL_S3_MODEL_PREFIX instead.",
        )
    if metadata is not None:
        beside = str(metadata), _read(metadata)
    place, content = beside or _beside(path)
    return PolicyFile(
        form,
        data,
        weights,
        origin,
        ModelMetadata.from_bytes(content, place),
        place,
        Fingerprint.of(data + weights).sha256,
    )


def metadata_path(path: Path) -> Path:
    """`NAME.model_metadata.json` beside it."""
    return path.with_name(f"{path.stem}.{METADATA}")


def _beside(path: Path) -> tuple[str, bytes]:
    for place in (metadata_path(path), path.with_name(METADATA)):
        if place.exists():
            return str(place), _read(place)
    raise SettingsError(
        f"{path} has no {METADATA}: neither {metadata_path(path).name} nor {METADATA} lies "
        "beside it.",
        remedy=f"Name the {METADATA} that says its sensors and actions, with --metadata FILE.",
    )


def _from_archive(path: Path) -> tuple[str, bytes, tuple[str, bytes] | None]:
    members = read_archive(path)
    graphs = [name for name in members if name.endswith(".pb")]
    if "agent/model.pb" in graphs:
        graphs = ["agent/model.pb"]
    if len(graphs) != 1:
        found = f"{len(graphs)} ({', '.join(few(map(shown, graphs)))})" if graphs else "none"
        raise SettingsError(
            f"{path} is not the archive of a car: instead of one frozen graph it has {found}.",
            remedy="Unpack the file that is meant, and name that one.",
        )
    texts = [name for name in members if name.rpartition("/")[2] == METADATA]
    if METADATA in texts:
        texts = [METADATA]
    if len(texts) > 1:
        raise SettingsError(
            f"{path} has {len(texts)} files {METADATA}.",
            remedy="Name the one that is meant, with --metadata FILE.",
        )
    beside = (f"{path}: {texts[0]}", members[texts[0]]) if texts else None
    return f"{path}: {graphs[0]}", members[graphs[0]], beside


def _read(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > LARGEST_BYTES:
            raise OSError(0, f"it has {size:,} bytes, more than any policy")
        data = read_regular(path)
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be read: {error.strerror or error}.",
            remedy="Name a file that you can read on this machine.",
        ) from None
    if not data:
        raise SettingsError(f"{path} is empty.", remedy="Write it again, or name another file.")
    return data


def _refuse_pickle(path: Path) -> NoReturn:
    _read(path)  # a file that does not exist is called missing
    raise SettingsError(
        f"{path} is a Python pickle, as Stable-Baselines3 and PyTorch save models, and could run "
        "any program when it is read.",
        remedy="Export the policy as ONNX where it was trained, and name that file with --model; "
        f"{DOCUMENTED}.",
    )

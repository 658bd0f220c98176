"""Checks an archive by the car's rules before it is sent, because the car names no reasons.

The car unpacks the archive, takes the only model file in it and the `model_metadata.json` at its
root, and drops everything else.
"""

import json
import re
import tarfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn

from drcli.base.errors import SettingsError
from drcli.base.problems import shown

RESERVED = ("aws-golden-model-for-reinvent", "AWS Sample")
"""Names of models that belong to the car's software."""

SENSORS = frozenset(
    {
        "observation",
        "FRONT_FACING_CAMERA",
        "LEFT_CAMERA",
        "STEREO_CAMERAS",
        "LIDAR",
        "SECTOR_LIDAR",
    }
)
"""Sensors that the car knows."""

_CHOICES = {
    "training_algorithm": ("clipped_ppo", "sac"),
    "action_space_type": ("discrete", "continuous"),
}
"""Keys of the metadata whose values the car compares; each may be missing."""

_METADATA = "model_metadata.json"
_NAME = re.compile(r"[A-Za-z0-9_-]+")
_END = ".tar.gz"
_MOST_BYTES = 1 << 30
_MOST_MEMBERS = 10_000
_MOST_METADATA_BYTES = 1 << 20
_EXPORT = "Export the model again with `dr-export car`."


@dataclass(frozen=True)
class CarFile:
    """An archive that keeps the car's rules.

    Attributes:
        name: Of the model on the car: the file's name without its end.
        sensors: That the model needs.
    """

    path: Path
    name: str
    sensors: tuple[str, ...]


def check_file(path: Path) -> CarFile:
    """Read an archive and check name and content; nothing is unpacked.

    Raises:
        SettingsError: The car would not take it.
    """
    name = _checked_name(path)
    models: list[str] = []
    metadata: bytes | None = None
    for member, content in _members(path):
        plain = PurePosixPath(member.name)
        if plain.is_absolute() or ".." in plain.parts:
            _refuse(path, f"{shown(member.name)} would lie outside of the model's folder")
        if not (member.isfile() or member.isdir()):
            _refuse(path, f"{shown(member.name)} is neither a file nor a folder")
        if member.isdir():
            continue
        if _counts_as_model(plain.name):
            models.append(member.name)
            if plain.suffix == ".pb" and member.size == 0:
                _refuse(path, f"{shown(member.name)} is empty")
        if plain == PurePosixPath(_METADATA):
            metadata = content
    strays = [model for model in models if PurePosixPath(model).suffix != ".pb"]
    if strays:
        _refuse(
            path,
            f"the car takes {_listed(strays)} for model files, because files without an extension "
            "and with .p or .b count as such",
        )
    if len(models) != 1:
        found = f"{len(models)} model files ({_listed(models)})" if models else "no model file"
        _refuse(path, f"it has {found}, and the car needs exactly one .pb")
    if metadata is None:
        _refuse(path, f"it has no {_METADATA} outside of folders")
    return CarFile(path, name, _sensors(path, metadata))


def _checked_name(path: Path) -> str:
    """The name of the model that a file becomes."""
    if not path.name.endswith(_END):
        _refuse(path, f"its name does not end in {_END}", "Give the archive for the car.")
    name = path.name.removesuffix(_END)
    if name in RESERVED or not _NAME.fullmatch(name):
        why = "belongs to the car's software" if name in RESERVED else "would be changed by the car"
        _refuse(
            path,
            f"the name {shown(name)} {why}",
            f"Rename it: letters, digits, - and _ before {_END}, and no other dot or space.",
        )
    return name


def _members(path: Path) -> Iterator[tuple[tarfile.TarInfo, bytes]]:
    """The members of the archive in their order; the content only of what may be metadata."""
    total = 0
    try:
        with path.open("rb") as file, tarfile.open(fileobj=file, mode="r|gz") as archive:
            for count, member in enumerate(archive, 1):
                total += member.size
                if total > _MOST_BYTES or count > _MOST_MEMBERS:
                    _refuse(path, "it unpacks to more than 1 GiB or 10,000 files")
                content = b""
                if PurePosixPath(member.name) == PurePosixPath(_METADATA) and member.isfile():
                    if member.size > _MOST_METADATA_BYTES:
                        _refuse(path, f"its {_METADATA} is larger than 1 MiB")
                    reader = archive.extractfile(member)
                    content = b"" if reader is None else reader.read()
                yield member, content
    except OSError as e:
        if e.strerror is None:  # gzip's own
            _refuse(path, f"it is not a whole gzip file ({e})")
        _refuse(path, f"it cannot be read ({e.strerror})", "Check the name of the file.")
    except (tarfile.TarError, EOFError, zlib.error) as e:
        _refuse(path, f"it is not a whole .tar.gz archive ({str(e) or 'it ends too early'})")


def _counts_as_model(name: str) -> bool:
    """Whether the car takes a file for a model: it looks for the extension in the text ".pb"."""
    extension = PurePosixPath(name).suffix
    return extension in ("", ".p", ".b", ".pb") or name.endswith(".")


def _sensors(path: Path, metadata: bytes) -> tuple[str, ...]:
    """The sensors in the metadata, which is checked as the car does it."""
    try:
        values: Any = json.loads(metadata)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        _refuse(path, f"its {_METADATA} is not a JSON object")
    for key, choices in _CHOICES.items():
        value = values.get(key, choices[0])
        if value not in choices:
            wrong = f"{key} in its {_METADATA} is {shown(str(value))}, not {' or '.join(choices)}"
            _refuse(path, wrong)
    if not values.get("action_space"):
        _refuse(path, f"its {_METADATA} has no action_space")
    sensors = values.get("sensor", ["observation"])
    if not isinstance(sensors, list) or not sensors or not all(map(_is_text, sensors)):
        _refuse(path, f"sensor in its {_METADATA} is not a list of names")
    unknown = [sensor for sensor in sensors if sensor not in SENSORS]
    if unknown:
        _refuse(path, f"the car does not know the sensor {_listed(unknown)} in its {_METADATA}")
    return tuple(sensors)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _listed(names: list[str]) -> str:
    """The first names of a list."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(shown(name) for name in names[:3]) + more


def _refuse(path: Path, reason: str, remedy: str = _EXPORT) -> NoReturn:
    raise SettingsError(f"{path}: the car cannot use this file: {reason}.", remedy=remedy)

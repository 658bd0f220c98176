"""Frozen dataclasses as JSON and back, every value checked by msgspec.

Dataclasses, because callers keep `replace` and `asdict`, and msgspec's own structs are hardly
faster: they take 25 ms for 5,000 iterations, these 32 ms. msgspec leaves defaults to the class, so
`vars` of a record that was read lacks them. Not pydantic: `dr-status` and the Tab key read such
records, and it loads in 0.09 s of processor time, msgspec in 0.015 s.
"""

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

import msgspec

from drcli.base.errors import Problem

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

LARGEST_INT = 2**53
"""A float holds all up to it exactly."""

SafeInt = Annotated[int, msgspec.Meta(ge=-LARGEST_INT, le=LARGEST_INT)]
Count = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_INT)]

Pid = Annotated[int, msgspec.Meta(ge=1, le=2**31 - 1)]

Amount = Annotated[float, msgspec.Meta(ge=0.0, le=1e11)]
Seconds = Annotated[float, msgspec.Meta(ge=-1e11, le=1e11)]
"""As Unix time, up to the year 5138."""

Text = Annotated[str, msgspec.Meta(min_length=1)]
Words = Annotated[str, msgspec.Meta(pattern=r"\S")]
"""Not blank."""

T = TypeVar("T")


class RecordError(ValueError):
    """Says where."""


class NewerFormat(RecordError):
    """A newer drcli has written the record."""


class JsonRecord:
    """A frozen dataclass that one process writes as a JSON object and another reads."""

    VERSION: ClassVar[int] = 1
    """Of the format. Files without the key `format` have version 1."""

    def encode(self) -> bytes:
        """The record as JSON text."""
        return json.dumps(self.to_json(), allow_nan=False).encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a record; RecordError if it is damaged, NewerFormat if it is a newer one."""
        version = decode_json(_Format, data).format
        if version != cls.VERSION:
            error = NewerFormat if version > cls.VERSION else RecordError
            raise error(f"its format is {version}, not {cls.VERSION}")
        return decode_json(cls, data)

    def to_json(self) -> dict[str, Any]:
        """The record as a JSON object."""
        version = {} if self.VERSION == 1 else {"format": self.VERSION}
        dataclass: Any = self
        return {**dataclasses.asdict(dataclass), **version}


@dataclass(frozen=True)
class _Format:
    format: Annotated[int, msgspec.Meta(ge=1)] = 1


def decode_json(kind: type[T], data: bytes) -> T:
    """Ignores other keys: a newer version may have written them.

    Raises:
        RecordError: It is not JSON, or a key is missing or wrong.
    """
    if b"\\ud" in data:  # half a pair, as in a path that is not UTF-8, is refused by msgspec
        return _checked(lambda: msgspec.convert(json.loads(data), kind, dec_hook=_read))
    # Decoded first: msgspec skips names of keys that are not UTF-8, which are damaged ones.
    return _checked(lambda: msgspec.json.decode(data.decode(), type=kind, dec_hook=_read))


def from_json(kind: type[T], value: Any) -> T:
    """As `decode_json`, of a value that was read before."""
    return _checked(lambda: msgspec.convert(value, kind, dec_hook=_read))


def plain_json(record: "DataclassInstance") -> Any:
    """As `json.loads` would read it again."""
    return json.loads(json.dumps(dataclasses.asdict(record), default=json_default))


def json_default(value: Any) -> Any:
    """For `json.dumps`."""
    return value.to_json() if hasattr(value, "to_json") else str(value)


def _checked(read: Callable[[], T]) -> T:
    try:
        return read()
    except (msgspec.DecodeError, ValueError, RecursionError) as e:
        raise RecordError(str(e)) from e


def _read(kind: Any, value: Any) -> Any:
    if kind is Path and isinstance(value, str):
        return Path(value)
    if hasattr(kind, "from_json"):
        return kind.from_json(value)
    raise RecordError(f"it is not a {kind.__name__}")


# Reports as JSON, for `--json` and the console.


def keys_of(report: "DataclassInstance") -> dict[str, Any]:
    names = [field.name for field in dataclasses.fields(report)]
    names += [name for name, it in vars(type(report)).items() if isinstance(it, property)]
    return {name: plain(getattr(report, name)) for name in names}


def plain(value: Any) -> Any:
    """NaN and infinities become null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Problem):
        return value.as_json()
    if isinstance(value, PurePath):
        return str(value)
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return {field.name: plain(getattr(value, field.name)) for field in fields}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


# Size and hash show whether an object is complete and unchanged.


@dataclass(frozen=True)
class Fingerprint:
    """SHA-256, because `sha256sum` checks it as well; 23 MB take about 15 ms."""

    size_bytes: int
    sha256: str

    @classmethod
    def of(cls, data: bytes) -> "Fingerprint":
        return cls(len(data), hashlib.sha256(data).hexdigest())

    def fault(self, data: bytes) -> str | None:
        """None if unchanged."""
        if len(data) != self.size_bytes:
            return f"{len(data)} bytes instead of {self.size_bytes}"
        if hashlib.sha256(data).hexdigest() != self.sha256:
            return "its SHA-256 differs from the recorded one"
        return None

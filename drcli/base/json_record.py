"""Frozen dataclasses as JSON and back, every value checked.

Not pydantic, because `dr-status` and the Tab key read such records: that takes 0.09 s of processor
time, this module 0.02 s.
"""

import dataclasses
import hashlib
import json
import math
import re
import sys
import types
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePath
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    NoReturn,
    Self,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from drcli.base.errors import Problem

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_LARGEST_INT = 2**53
"""Of a float."""

_INT_LIMITS = (-_LARGEST_INT, _LARGEST_INT)

_LARGEST_PID = 2**31 - 1
_LATEST_S = 1e11
"""The year 5138."""

MaybeNan = Annotated[float, "may be NaN"]
"""NaN, or null in strict JSON."""

_PID = re.compile(r"(^|_)pid")
_SECONDS = re.compile(r"(_s|_at|_started|^renewed|^since|time_stamp)$")

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
        return cls.from_json(parse_json(data))

    def to_json(self) -> dict[str, Any]:
        """The record as a JSON object."""
        dataclass: Any = self
        version = {} if self.VERSION == 1 else {"format": self.VERSION}
        return {**dataclasses.asdict(dataclass), **version}

    @classmethod
    def from_json(cls, value: Any) -> Self:
        """The record in a JSON object; RecordError as for `decode`."""
        version = value.get("format", 1) if isinstance(value, dict) else 1
        if type(version) is not int or version != cls.VERSION:
            newer = type(version) is int and version > cls.VERSION
            error = NewerFormat if newer else RecordError
            raise error(f"its format is {_short(version)}, not {cls.VERSION}")
        return from_json(cls, value)


def parse_json(data: bytes, *, with_nan: bool = False) -> Any:
    """RecordError if it is not JSON; `with_nan` also takes NaN and Infinity, as Python writes."""
    if not data.strip():
        raise RecordError("it is empty")
    try:
        return json.loads(data, parse_constant=None if with_nan else _refuse_constant)
    except RecordError:
        raise
    except UnicodeDecodeError as e:
        raise RecordError(
            f"byte 0x{data[e.start]:02x} at position {e.start} is not UTF-8 text"
        ) from e
    except json.JSONDecodeError as e:
        raise RecordError(f"it is not JSON (line {e.lineno} column {e.colno}: {e.msg})") from e
    except (ValueError, RecursionError) as e:  # a number with 5,000 digits; 100,000 brackets
        raise RecordError(f"it is not JSON ({e})") from e


def json_default(value: Any) -> Any:
    """For `json.dumps`."""
    return value.to_json() if hasattr(value, "to_json") else str(value)


def from_json(kind: type[T], value: Any) -> T:
    """Ignores other keys: a newer version may have written them.

    Raises:
        RecordError: A key is missing or wrong.
    """
    if not isinstance(value, dict):
        raise RecordError(f"it is {_kind_of(value)} instead of an object with keys")
    dataclass: Any = kind  # mypy does not know this of a type variable
    found: dict[str, Any] = {}
    for name, hint, is_required, is_optional, usual, lowest, highest in _checks(dataclass):
        if name not in value:
            if is_required:
                raise RecordError(f"'{name}' is missing")
            continue
        given = value[name]
        # Files of long trainings have ten thousand records, so the usual values are checked first.
        if type(given) is usual and (lowest is None or lowest <= given <= highest):
            found[name] = given
        elif given is None and is_optional:
            found[name] = None
        else:
            found[name] = _fitted(name, hint, given)
    return kind(**found)


@cache
def _checks(kind: Any) -> tuple[tuple[str, Any, bool, bool, Any, Any, Any], ...]:
    """For each field: name, hint, required, optional, usual type, limits."""
    hints = _hints(kind)
    checks = []
    for item in dataclasses.fields(kind):
        missing = dataclasses.MISSING
        is_required = item.default is missing and item.default_factory is missing
        hint = hints[item.name]
        inner = [each for each in get_args(hint) if each is not type(None)]
        is_optional = get_origin(hint) in (Union, types.UnionType) and len(inner) == 1
        plain = float if hint is MaybeNan else inner[0] if is_optional else hint
        usual: Any = None
        lowest: float | None = None
        highest: float | None = None
        if plain is float:
            usual = float
            highest = _LATEST_S if _SECONDS.search(item.name) else sys.float_info.max
            lowest = -highest
        elif plain is int:
            usual = int
            lowest, highest = (1, _LARGEST_PID) if _PID.search(item.name) else _INT_LIMITS
        elif plain in (str, bool):
            usual = plain
        checks.append((item.name, hint, is_required, is_optional, usual, lowest, highest))
    return tuple(checks)


@cache
def _hints(kind: Any) -> Mapping[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _fitted(name: str, hint: Any, value: Any) -> Any:
    origin, inner = get_origin(hint), get_args(hint)
    if hint is Any:
        return value
    if hint is MaybeNan:
        unknown = value is None or (isinstance(value, float) and not math.isfinite(value))
        return math.nan if unknown else _plain(name, float, value)
    if hint is Path:
        return Path(_plain(name, str, value))
    if origin in (Union, types.UnionType):
        if value is None and type(None) in inner:
            return None
        [only] = [each for each in inner if each is not type(None)]
        return _fitted(name, only, value)
    if origin is Literal:
        return value if value in inner else _refuse(name, value)
    if origin in (list, tuple):
        if not isinstance(value, list):
            _refuse(name, value)
        if inner[0] is float and all(type(x) is float and abs(x) <= _LATEST_S for x in value):
            return value if origin is list else tuple(value)
        items = [_fitted(name, inner[0], item) for item in value]
        return items if origin is list else tuple(items)
    if isinstance(hint, type) and issubclass(hint, tuple):  # with names
        kinds = _hints(hint).values()
        if not isinstance(value, list) or len(value) != len(kinds):
            _refuse(name, value)
        return hint(*(_fitted(name, of, item) for of, item in zip(kinds, value, strict=True)))
    if hint is dict or (origin is not None and issubclass(origin, Mapping)):
        if not isinstance(value, dict):
            _refuse(name, value)
        of = inner[1] if inner else Any
        return {key: _fitted(f"{name}.{key}", of, item) for key, item in value.items()}
    if isinstance(hint, type) and (dataclasses.is_dataclass(hint) or hasattr(hint, "from_json")):
        try:
            return (
                from_json(hint, value) if dataclasses.is_dataclass(hint) else hint.from_json(value)
            )
        except RecordError as e:
            raise RecordError(f"in '{name}': {e}") from e
    return _plain(name, hint, value)


def _plain(name: str, hint: Any, value: Any) -> Any:
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        limit = _LATEST_S if _SECONDS.search(name) else math.inf
        try:
            number = float(value)
        except OverflowError:
            _refuse(name, value)
        return number if math.isfinite(number) and abs(number) <= limit else _refuse(name, value)
    if hint is int and isinstance(value, int) and not isinstance(value, bool):
        fits = 0 < value <= _LARGEST_PID if _PID.search(name) else abs(value) <= _LARGEST_INT
        return value if fits else _refuse(name, value)
    return value if hint in (str, bool) and isinstance(value, hint) else _refuse(name, value)


def _refuse(name: str, value: Any) -> NoReturn:
    raise RecordError(f"'{name}' cannot be {_short(value)}")


def _short(value: Any) -> str:
    text = json.dumps(value) if not isinstance(value, int) or abs(value) < 1e18 else "a huge number"
    return text if len(text) <= 40 else f"{text[:37]}..."


def _refuse_constant(word: str) -> NoReturn:
    raise RecordError(f"it is not JSON (it contains {word})")


def _kind_of(value: Any) -> str:
    if isinstance(value, list):
        return "a list"
    if isinstance(value, str):
        return "a text"
    return "null" if value is None else "a single value"


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

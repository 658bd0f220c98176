"""How a DR_ name is declared: one field with its type, default, range and meaning."""

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, cast, get_args, get_origin
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from drcli.findings import UnfitError

T = TypeVar("T")

Effect = Literal["used", "accepted", "planned"]
"""Whether a setting does something here: `accepted` is harmless to ignore, `planned` is not."""

FileName = Literal["run.env", "system.env"]
"""Where a setting belongs; it counts in both files."""


class Group(BaseModel):
    """Settings that belong together.

    Attributes:
        title: Heading in the documentation.
        file: Where they belong.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    title: ClassVar[str]
    file: ClassVar[FileName] = "run.env"


@dataclass(frozen=True)
class Shape:
    """What may be written into a text, as it reads after `Set it to`."""

    words: str


def setting(
    name: str,
    default: T,
    meaning: str,
    *,
    low: float | None = None,
    high: float | None = None,
    old_names: tuple[str, ...] = (),
    planned: str = "",
    ignored: str = "",
    file: FileName | None = None,
) -> T:
    """Declare a field of a group.

    Args:
        name: Its DR_ name, which stands nowhere else.
        default: Its value when nobody sets it; texts may hold `$NAME`.
        meaning: One line for the documentation.
        low: Least value allowed.
        high: Greatest value allowed.
        old_names: Names that earlier versions of the reference used for it.
        planned: Why it does nothing yet, although somebody who changes it expects an effect.
        ignored: Why it may be ignored for good.
        file: Where it belongs, if not where its group does.
    """
    facts = {
        "name": name,
        "low": low,
        "high": high,
        "old_names": list(old_names),
        "effect": "planned" if planned else "accepted" if ignored else "used",
        "reason": planned or ignored,
        "file": file,
    }
    return Field(default, description=meaning, ge=low, le=high, json_schema_extra=cast(Any, facts))


@dataclass(frozen=True)
class Setting:
    """What is known about one DR_ name.

    Attributes:
        name: The DR_ name.
        field: Attribute of `Settings`.
        kind: What its text must be: text, flag, whole, number, choice, path or list.
        choices: The allowed words of a choice.
        default: Value when nobody sets it.
        meaning: One line.
        low: Least number, if limited.
        high: Greatest number, if limited.
        effect: Whether it does something here.
        reason: Why it does not.
        old_names: Names that mean the same.
        shape: What a text may be.
        group: Heading in the documentation.
        file: Where it belongs; it counts in both files.
    """

    name: str
    field: str
    kind: str
    choices: tuple[str, ...]
    default: Any
    meaning: str
    low: float | None
    high: float | None
    effect: Effect
    reason: str
    old_names: tuple[str, ...]
    shape: str
    group: str
    file: FileName

    @property
    def default_text(self) -> str:
        """The default as it would be written in a settings file."""
        return "" if self.default in (None, ()) else str(self.default)

    @property
    def expected(self) -> str:
        """What may be written, as it reads after `Set it to`."""
        words = {
            "flag": "True or False",
            "whole": "a whole number",
            "number": "a number",
            "path": "a folder",
            "list": "progress,lane pairs such as 0.23,-1;0.46,1",
        }
        text = words.get(self.kind) or self.shape or "any text"
        if self.choices:
            text = f"one of {', '.join(self.choices)}"
        if self.low is not None and self.high is not None:
            return f"{text} from {self.low} to {self.high}"
        return text if self.low is None else f"{text}, {self.low} or more"


def declared(model: type[BaseModel]) -> Mapping[str, Setting]:
    """Every setting of a model by its DR_ name, in the order of declaration."""
    owners = {
        field: base
        for base in model.__mro__
        if issubclass(base, Group)
        for field in inspect.get_annotations(base)
    }
    found = {}
    for field, info in model.model_fields.items():
        facts = cast(dict[str, Any], info.json_schema_extra)
        if facts is None:
            continue
        kind, choices = _kind(info.annotation)
        group = owners[field]
        shapes = [hint.words for hint in info.metadata if isinstance(hint, Shape)]
        found[facts["name"]] = Setting(
            field=field,
            kind=kind,
            choices=choices,
            default=info.default,
            meaning=info.description or "",
            shape="".join(shapes),
            group=group.title,
            **{
                **facts,
                "old_names": tuple(facts["old_names"]),
                "file": facts["file"] or group.file,
            },
        )
    return found


def _kind(annotation: Any) -> tuple[str, tuple[str, ...]]:
    if get_origin(annotation) is Literal:
        return "choice", get_args(annotation)
    if isinstance(annotation, UnionType):
        (annotation,) = (kind for kind in get_args(annotation) if kind is not NoneType)
    kinds = {str: "text", bool: "flag", int: "whole", float: "number", Path: "path"}
    return kinds.get(annotation, "list"), ()


def _object_key(value: str) -> str:
    if not value:
        raise UnfitError("is empty", "Write a name such as rl-deepracer-1.")
    bad = re.search(r"[^A-Za-z0-9._/-]", value)
    if bad is not None:
        raise UnfitError(
            f"holds {bad[0]!a}, which cannot stand in a name in the bucket",
            "Use only letters, digits, and the characters . _ - /.",
        )
    if any(part in ("", ".", "..") for part in value.split("/")):
        raise UnfitError(
            "has an empty part, . or .. between its slashes",
            "Write folders as in team/model-1, without / at the start or the end.",
        )
    return value


def _world(value: str) -> str:
    if not value:
        raise UnfitError("is empty", "Write the name of a track, such as reinvent_base.")
    if not value.endswith(".npy") and not re.fullmatch(r"[A-Za-z0-9._-]+", value):
        raise UnfitError(
            "cannot be the name of a track",
            "Write a name such as reinvent_base, or the path of a .npy file.",
        )
    return value


def _bucket(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{2,62}", value):
        raise UnfitError(
            "is no name of a bucket",
            "Write its plain name of 3 to 63 letters, digits, dots and hyphens, without s3://.",
        )
    return value


def _address(value: str) -> str:
    try:
        address = urlsplit(value)
        fit = address.scheme in ("http", "https") and bool(address.hostname)
        fit = fit and address.port != 0
    except ValueError:
        fit = False
    if value and not fit:
        raise UnfitError("is no web address", "Write it as in http://192.168.1.5:9000.")
    return value


def _colour(value: str) -> str:
    named = {colour.casefold(): colour for colour in _COLOURS}
    if value.casefold() not in named and not value.startswith("f1_car_"):
        raise UnfitError(
            f"is none of {', '.join(_COLOURS)}", f"Write one of {', '.join(_COLOURS)}."
        )
    return named.get(value.casefold(), value)


def _folder_name(value: str) -> str:
    if value and not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]*", value):
        raise UnfitError("is no plain folder name", "Write the name of a folder in experiments/.")
    return value


def _positions(value: Any) -> Any:
    """`0.23,-1;0.46,1` as pairs; progress is a fraction of the lap, lane -1 is the outer one."""
    if not isinstance(value, str):
        return value
    try:
        pairs = [
            tuple(float(number) for number in pair.split(","))
            for pair in value.split(";")
            if pair.strip()
        ]
    except ValueError:
        pairs = [()]
    if any(len(pair) != 2 or not 0.0 <= pair[0] <= 1.0 for pair in pairs):
        raise UnfitError(
            "is no list of progress,lane pairs",
            'Write progress 0 to 1 and lane 1 or -1, as in "0.23,-1;0.46,1".',
        )
    return tuple(pairs)


_COLOURS = ("Black", "Grey", "Blue", "Red", "Orange", "White", "Purple")

ObjectKey = Annotated[
    str,
    AfterValidator(_object_key),
    Shape("a name in the bucket: letters, digits and . _ - /"),
]
"""A key or prefix in the bucket."""
WorldName = Annotated[
    str, AfterValidator(_world), Shape("the name of a track, or the path of a .npy file")
]
"""Has the shape of a track name; whether the track exists is known to the simulation."""
BucketName = Annotated[
    str, AfterValidator(_bucket), Shape("the name of a bucket: 3 to 63 letters, digits, . _ and -")
]
UploadBucket = Annotated[
    str,
    AfterValidator(lambda name: _bucket(name) if name else name),
    Shape("the name of a bucket, or not-defined"),
]
Address = Annotated[str, AfterValidator(_address), Shape("an http or https address, or nothing")]
"""http or https address, or empty."""
Colour = Annotated[
    str, AfterValidator(_colour), Shape(f"one of {', '.join(_COLOURS)}, or f1_car_ and a colour")
]
FolderName = Annotated[
    str, AfterValidator(_folder_name), Shape("the name of a folder in experiments/, or nothing")
]
Positions = Annotated[tuple[tuple[float, float], ...], BeforeValidator(_positions)]
"""Progress (fraction of the lap) and lane (-1 outer, any other inner) of each obstacle."""

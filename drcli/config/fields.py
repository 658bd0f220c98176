"""How a DR_ name is declared: one field with its type, default, range and meaning.

Pydantic's core reads only what somebody wrote: all of pydantic takes a quarter of a second.
"""

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import NoneType, SimpleNamespace, UnionType
from typing import Any, ClassVar, Literal, NoReturn, Self, TypeVar, cast, get_args, get_origin
from urllib.parse import urlsplit

from pydantic_core import SchemaValidator, ValidationError, core_schema

from drcli.base.errors import BadValue, Place, Problem, Severity, not_one_of
from drcli.base.json_record import RecordError
from drcli.config.value_types import Check, Shape

T = TypeVar("T")

Effect = Literal["used", "accepted", "planned"]
"""`accepted` is harmless to ignore, `planned` is not."""

FileName = Literal["run.env", "system.env"]
_UNREADABLE = {
    "flag": "is neither True nor False",
    "whole": "is not a whole number",
    "number": "is not a number",
}


class Group:
    """Settings that belong together, usually in `file`; `ignored`: why they do nothing."""

    title: ClassVar[str]
    file: ClassVar[FileName]
    ignored: ClassVar[str]

    def __init_subclass__(
        cls, title: str = "", file: FileName = "run.env", ignored: str = ""
    ) -> None:
        super().__init_subclass__()
        cls.title, cls.file, cls.ignored = title, file, ignored


@dataclass(frozen=True)
class Setting:
    """What is known about one DR_ name; `declared` fills in the defaults.

    Attributes:
        old_names: Names in earlier versions of the reference.
        cosmetic: A wrong value is a warning, and the default is used.
        kind: text, flag, whole, number, choice, path or list.
        shape: What a text may be.
        check: Returns the value of a text of that kind.
        hints: Remedies for words that are often written instead of a choice, in capitals.
    """

    name: str
    default: Any
    meaning: str
    low: float | None
    high: float | None
    old_names: tuple[str, ...]
    effect: Effect
    reason: str
    own_file: FileName | None
    cosmetic: bool = False
    file: FileName = "run.env"
    field: str = ""
    group: str = ""
    kind: str = ""
    choices: tuple[str, ...] = ()
    shape: str = ""
    check: Callable[[str], Any] | None = None
    hints: Mapping[str, str] | None = None

    @property
    def default_text(self) -> str:
        return self.text(self.default)

    @property
    def expected(self) -> str:
        """As it reads after `Set it to`."""
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

    def text(self, value: Any) -> str:
        """A value as in a settings file."""
        if self.kind == "list":
            return ";".join(f"{progress},{lane}" for progress, lane in value)
        return "" if value is None else str(value)

    def read(self, text: str) -> Any:
        """The value that a text means.

        Raises:
            BadValue: The text does not fit.
        """
        value = self._of_kind(text)
        return value if self.check is None else self.check(value)

    def _of_kind(self, text: str) -> Any:
        if self.kind == "choice":
            words = {word.casefold(): word for word in self.choices}
            if text.casefold() not in words:
                bad = not_one_of(self.choices, text)
                bad.remedy = (self.hints or {}).get(text.upper(), bad.remedy)
                raise bad
            return words[text.casefold()]
        if self.kind not in _UNREADABLE:
            return Path(text) if self.kind == "path" else text
        try:
            return _reader(self.kind, self.low, self.high).validate_python(text)
        except ValidationError as e:
            fault = e.errors(include_url=False)[0]["type"]
            reason = _UNREADABLE[self.kind]
            if fault == "greater_than_equal":
                reason = f"is below {self.low}"
            elif fault == "less_than_equal":
                reason = f"is above {self.high}"
            default = self.default_text
            other = f", or leave it out for the default {default}" if default else ""
            raise BadValue(reason, f"Set {self.name} to {self.expected}{other}.") from None


def setting(
    name: str,
    default: T,
    meaning: str,
    *,
    low: float | None = None,
    between: tuple[float, float] | None = None,
    old_names: tuple[str, ...] = (),
    planned: str = "",
    ignored: str = "",
    file: FileName | None = None,
    cosmetic: bool = False,
    choices: tuple[str, ...] = (),
    hints: Mapping[str, str] | None = None,
) -> T:
    """Declare a field of a group: see `Setting`. Texts of defaults may hold `$NAME`.

    `planned`: why it does nothing although somebody expects an effect; `ignored`: why for good.
    """
    effect: Effect = "planned" if planned else "accepted" if ignored else "used"
    reason = planned or ignored
    low, high = between or (low, None)
    given = name, default, meaning, low, high, old_names, effect, reason, file, cosmetic
    return cast(T, Setting(*given, choices=choices, hints=hints))


@cache
def _reader(kind: str, low: float | None, high: float | None) -> SchemaValidator:
    if kind == "flag":
        return SchemaValidator(core_schema.bool_schema())
    if kind == "whole":
        least, most = (None if edge is None else int(edge) for edge in (low, high))
        return SchemaValidator(core_schema.int_schema(ge=least, le=most))
    return SchemaValidator(core_schema.float_schema(ge=low, le=high, allow_inf_nan=False))


def declared(model: type[Any]) -> Mapping[str, Setting]:
    """Every setting of a model by its DR_ name."""
    found = {}
    groups = [base for base in reversed(model.__mro__) if issubclass(base, Group)]
    for group in groups:
        for field, annotation in inspect.get_annotations(group).items():
            given = vars(group).get(field)
            if not isinstance(given, Setting):
                continue
            hints = getattr(annotation, "__metadata__", ())
            kind, choices = _kind(get_args(annotation)[0] if hints else annotation)
            if given.choices:
                kind, choices = "choice", given.choices
            ignored = group.ignored if given.effect == "used" else ""
            found[given.name] = replace(
                given,
                effect="accepted" if ignored else given.effect,
                reason=ignored or given.reason,
                file=given.own_file or group.file,
                field=field,
                group=group.title,
                kind=kind,
                choices=choices,
                shape="".join(hint.words for hint in hints if isinstance(hint, Shape)),
                check=next((hint.check for hint in hints if isinstance(hint, Check)), None),
            )
    return found


def _kind(annotation: Any) -> tuple[str, tuple[str, ...]]:
    if get_origin(annotation) is Literal:
        return "choice", get_args(annotation)
    if isinstance(annotation, UnionType):
        (annotation,) = (kind for kind in get_args(annotation) if kind is not NoneType)
    kinds = {str: "text", bool: "flag", int: "whole", float: "number", Path: "path"}
    return kinds.get(annotation, "list"), ()


class FrozenGroups(SimpleNamespace):
    """Groups of settings as one frozen value, also as JSON."""

    declared: ClassVar[Mapping[str, Setting]]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.declared = declared(cls)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{type(self).__name__} is frozen; change {name} with `replaced`.")

    def replaced(self, **changes: Any) -> Self:
        if unknown := changes.keys() - vars(self).keys():
            raise TypeError(f"{type(self).__name__} has no {', '.join(sorted(unknown))}.")
        return type(self)(**{**vars(self), **changes})

    def to_json(self) -> dict[str, Any]:
        return {item.field: item.text(getattr(self, item.field)) for item in self.declared.values()}

    @classmethod
    def from_json(cls, value: Any) -> Self:
        """Read and check what `to_json` made.

        Raises:
            RecordError: A setting is missing or its value is not allowed.
        """
        return cls(**cls.values_of(value))

    @classmethod
    def values_of(cls, value: Any) -> dict[str, Any]:
        """The same as values by field."""
        if not isinstance(value, dict):
            raise RecordError("a group of settings is not an object with keys")
        found = {}
        for item in cls.declared.values():
            field = item.field
            text = value.get(field)
            if not isinstance(text, str):
                raise RecordError(f"'{field}' is {'not a text' if field in value else 'missing'}")
            try:
                found[field] = item.read(text) if text or item.kind == "text" else item.default
            except BadValue as error:
                raise RecordError(f"'{field}' {error}") from error
        return found


# Problems with settings: broken rules, and which values may be shown.


RULES = {
    "DR_WORLD_NAME": "V-05",
    "DR_RACE_TYPE": "V-07",
    "DR_CAR_COLOR": "V-08",
    "DR_TRAIN_WORLDS": "V-05",
    "DR_TRAIN_EVAL_WORLD": "V-05",
    "DR_CURRICULUM_FILE": "V-60",
    "DR_LOCAL_S3_PRETRAINED": "V-10",
    "DR_LOCAL_S3_PRETRAINED_PREFIX": "V-10",
    "DR_LOCAL_S3_PRETRAINED_CHECKPOINT": "V-10",
    "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST": "V-42",
    "DR_WORKERS": "V-45",
}
GENERAL_RULE = "V-12"
HIDDEN = "(hidden)"

_SECRET = re.compile(
    r"SECRET|PASSWORD|PASSWD|TOKEN|CREDENTIAL|ACCESS_?KEY|API_?KEY|WEBHOOK", re.IGNORECASE
)
"""Whoever knows the address of a webhook may write there."""


def setting_problem(
    name: str, place: Place, message: str, remedy: str, *, severity: Severity = "error"
) -> Problem:
    """A problem with one setting; the message has its name and value."""
    return Problem(RULES.get(name, GENERAL_RULE), severity, *place, message, remedy, name)


def file_problem(
    place: Place, message: str, remedy: str, *, severity: Severity = "error"
) -> Problem:
    """A problem with a file, or a line that is not a setting."""
    return Problem(GENERAL_RULE, severity, *place, message, remedy)


def hidden(name: str, value: str) -> str:
    """A value without a secret, password or signature."""
    if _SECRET.search(name):
        return HIDDEN if value else ""
    if "://" not in value:
        return value
    try:
        address = urlsplit(value)
    except ValueError:
        return HIDDEN
    _, at, host = address.netloc.rpartition("@")
    shown = address._replace(
        netloc=f"{HIDDEN}@{host}" if at else host, query=HIDDEN if address.query else ""
    )
    return value if shown == address else shown.geturl()

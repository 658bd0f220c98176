"""Reports as JSON, for `--json` and the console."""

import dataclasses
import math
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from drcli.base.problems import Problem

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


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

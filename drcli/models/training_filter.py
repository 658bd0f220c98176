"""Conditions that choose trainings: time, state, comparison."""

import re
from collections.abc import Callable, Collection, Mapping
from datetime import datetime
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import Any, get_args

from drcli.base.errors import SettingsError
from drcli.base.moments import moment
from drcli.exchange.training_record import TrainingState

Condition = Callable[[Mapping[str, Any]], bool]

STATES: tuple[str, ...] = get_args(TrainingState)

_COMPARISON = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]*)\s*(<=|>=|!=|==|=|<|>)\s*(.*?)\s*")


def of_model(pattern: str) -> Condition:
    """By a part of the prefix, or `*` and `?`."""
    has_wildcards = any(character in pattern for character in "*?[")

    def fits(values: Mapping[str, Any]) -> bool:
        model = str(values["model"])
        return fnmatchcase(model, pattern) if has_wildcards else pattern in model

    return fits


def in_state(words: str) -> Condition:
    """States separated by commas; raises SettingsError."""
    wanted = [word.casefold() for word in re.split(r"[,\s]+", words) if word]
    for word in wanted:
        if word not in STATES:
            raise SettingsError(
                f"--state {word} is no state of a training.",
                remedy=f"Write some of {', '.join(STATES)}, separated by commas.",
            )
    return lambda values: values["state"] in wanted


def began(option: str, text: str, now: datetime, *, after: bool) -> Condition:
    """By a date in UTC, or an age; raises SettingsError."""
    limit = moment(option, text, now).strftime("%Y-%m-%dT%H:%M:%SZ")

    def fits(values: Mapping[str, Any]) -> bool:
        at = str(values["began_at"])
        return bool(at) and (at >= limit if after else at < limit)

    return fits


def where(text: str, names: Collection[str]) -> Condition:
    """A comparison such as `lr<0.001` or `DR_WORLD_NAME=reinvent*`.

    Texts are compared without case; = and != know `*` and `?`. A missing value fulfils only !=.

    Raises:
        SettingsError: It is not one, or no training can have such a value.
    """
    found = _COMPARISON.fullmatch(text)
    if found is None:
        raise SettingsError(
            f"--where {text} is no comparison.",
            remedy="Write one with =, !=, <, <=, > or >=, as in --where 'lr<0.001'.",
        )
    name, sign, wanted = found[1], found[2], found[3]
    known = {each.casefold(): each for each in names}
    if name.casefold() not in known:
        close = get_close_matches(name.casefold(), known, 3)
        likely = f"Did you mean {', '.join(known[each] for each in close)}? " if close else ""
        raise SettingsError(
            f"--where {text}: no training has a value {name}.",
            remedy=f"{likely}Use a setting, a hyperparameter, or a key of `dr-history --json`.",
        )
    name = known[name.casefold()]
    return lambda values: _holds(values.get(name), sign, wanted)


def _holds(value: Any, sign: str, wanted: str) -> bool:
    if value is None or value == "":
        return sign == "!=" and wanted != ""
    left, right = _number(value), _number(wanted)
    if left is not None and right is not None:
        return {
            "=": left == right,
            "==": left == right,
            "!=": left != right,
            "<": left < right,
            "<=": left <= right,
            ">": left > right,
            ">=": left >= right,
        }[sign]
    one, other = str(value).casefold(), wanted.casefold()
    if sign in ("=", "==", "!="):
        return fnmatchcase(one, other) == (sign != "!=")
    return {"<": one < other, "<=": one <= other, ">": one > other, ">=": one >= other}[sign]


def _number(value: Any) -> float | None:
    if isinstance(value, bool):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return None if number != number else number

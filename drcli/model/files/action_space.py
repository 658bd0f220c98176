"""The actions in model_metadata.json: a list or ranges."""

from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drcli.base.errors import BadValue, Problem
from drcli.model.files.data_file import JsonFile, KeyPath, Number, dotted

MANY_ACTIONS = 30
"""More learn slowly; the DeepRacer console allows no more."""

Pair = tuple[float, float]
"""Steering in degrees, left positive, and speed in m/s."""

USUAL = {"steering_angle": (-30.0, 30.0), "speed": (0.1, 4.0)}
"""The car cuts others to these. Source: the reference car."""

ACTION = {"steering_angle": 15, "speed": 1.0}
RANGES = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 2}}
_Quantity = Annotated[Number, Field(ge=-1000, le=1000)]


class ActionSpace(NamedTuple):
    """`values` (discrete) are in the order of the policy's outputs."""

    values: tuple[Pair, ...] = ()
    low: Pair | None = None
    high: Pair | None = None

    @property
    def continuous(self) -> bool:
        return self.low is not None

    @property
    def num_actions(self) -> int:
        return 2 if self.continuous else len(self.values)


class Action(BaseModel):
    model_config = ConfigDict(extra="allow")

    steering_angle: _Quantity
    speed: _Quantity
    index: Any = None


class Range(BaseModel):
    model_config = ConfigDict(extra="allow")

    low: _Quantity
    high: _Quantity

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if self.low >= self.high:
            raise BadValue(
                "has a low that is not below its high",
                "Write a low below the high; for a single value use discrete actions.",
            )
        return self


class Ranges(BaseModel):
    model_config = ConfigDict(extra="allow")

    steering_angle: Range
    speed: Range


def list_problems(file: JsonFile, actions: list[Action]) -> Iterator[Problem]:
    yield from _wrong_indices(file, [action.index for action in actions])
    first: dict[Pair, int] = {}
    for number, action in enumerate(actions):
        path: KeyPath = ("action_space", number)
        pair = (action.steering_angle, action.speed)
        if first.setdefault(pair, number) != number:
            what = f"action {number} repeats action {first[pair]}."
            remedy = "Remove one of them: it slows learning down and adds nothing."
            several = "actions repeat another one"
            yield file.problem("V-30", path, what, remedy, "warning", several)
        for key in USUAL:
            yield from _beyond_the_car(file, (*path, key), getattr(action, key), key)
    if len(actions) > MANY_ACTIONS:
        what = f"{len(actions)} actions learn slowly."
        remedy = f"Keep at most {MANY_ACTIONS}, or use ranges."
        yield file.problem("V-32", ("action_space",), what, remedy, "warning")


def range_problems(file: JsonFile, ranges: Ranges) -> Iterator[Problem]:
    for key in USUAL:
        for end in ("low", "high"):
            value = getattr(getattr(ranges, key), end)
            yield from _beyond_the_car(file, ("action_space", key, end), value, key)


def _beyond_the_car(file: JsonFile, path: KeyPath, value: float, key: str) -> Iterator[Problem]:
    low, high = USUAL[key]
    if not low <= value <= high:
        beyond = "less" if 0 <= value < low else "more"
        what = f"{dotted(path)}={value:g} is {beyond} than the car can do ({low:g} to {high:g})."
        remedy = f"Write a number from {low:g} to {high:g}; others are cut to that."
        several = "values of action_space are beyond what the car can do"
        yield file.problem("V-32", path, what, remedy, "warning", several)


def _wrong_indices(file: JsonFile, written: list[Any]) -> Iterator[Problem]:
    wrong = [n for n, index in enumerate(written) if index is not None and index != n]
    if wrong:
        what = (
            f"action_space has {len(wrong)} of {len(written)} actions whose index is not their "
            "position."
        )
        remedy = (
            "Nothing reads index, only the order of the actions counts: remove the indices, or "
            "sort the actions if you meant another order."
        )
        path: KeyPath = ("action_space", wrong[0], "index")
        yield file.problem("V-30", path, what, remedy, "warning")

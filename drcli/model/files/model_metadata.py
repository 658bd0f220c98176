"""model_metadata.json: actions, sensors, network and algorithm of a model."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator

from drcli.base.errors import BadValue, Problem, closest, one_of, refuse, shown
from drcli.learn.algorithms import ALGORITHMS, Algorithm, algorithm_named
from drcli.model.files.action_space import (
    ACTION,
    RANGES,
    Action,
    ActionSpace,
    Ranges,
    list_problems,
    range_problems,
)
from drcli.model.files.data_file import (
    JsonFile,
    KeyPath,
    Number,
    Whole,
    as_written,
    choice,
    dotted,
    problems_of,
    read_json_object,
)
from drcli.model.files.sensors import CAMERAS, CONFIGURED_LIDARS, LIDARS, SENSORS, eyes_of

Network = Literal[
    "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
    "DEEP_CONVOLUTIONAL_NETWORK",
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP",
    "COMPACT_CONVOLUTIONAL_NETWORK",
]
"""Includes a small one that learns faster."""
SpaceType = Literal["discrete", "continuous"]

_LIDAR = {"num_sectors": 8, "num_values_per_sector": 8, "clipping_dist": 2.0}
_LIDAR_EXAMPLES: dict[str, Any] = {"lidar_config": _LIDAR, **_LIDAR}
_LIST_EXAMPLES: dict[str, Any] = {"action_space": [ACTION], **ACTION}
_RANGE_EXAMPLES: dict[str, Any] = {"action_space": RANGES, **RANGES, "low": 1, "high": 2}
RULES = {
    "action_space": "V-30",
    "sensor": "V-33",
    "version": "V-33",
    "lidar_config": "V-33",
    "training_algorithm": "V-34",
    "neural_network": "V-36",
    "action_space_type": "V-36",
}
"""V-31 is about ranges of actions."""


def _version(written: Any) -> str:
    try:
        known = not isinstance(written, bool) and float(written) in range(1, 7)
    except (TypeError, ValueError, OverflowError):
        known = False
    if not known:
        raise BadValue("is not a version from 1 to 6", 'Write "version": "5".')
    return str(written).strip()


def _sensors(written: Any) -> tuple[str, ...]:
    if not isinstance(written, list) or not written:
        raise BadValue("is not a list of sensors", 'Write "sensor": ["FRONT_FACING_CAMERA"].')
    for name in written:
        if name not in CAMERAS + LIDARS:
            reason = f"contains {shown(str(name))}, which is not a known sensor"
            raise BadValue(reason, one_of(CAMERAS + LIDARS, str(name)))
    cameras = [name for name in written if name in CAMERAS]
    if len(cameras) != 1:
        reason = "contains more than one camera" if cameras else "does not contain a camera"
        raise BadValue(reason, f"Keep exactly one of {', '.join(CAMERAS)}.")
    if len(written) > 2:
        raise BadValue("contains more than one lidar", f"Keep at most one of {', '.join(LIDARS)}.")
    return tuple(written)


class LidarConfig(BaseModel):
    """How DISCRETIZED_SECTOR_LIDAR divides the rays."""

    model_config = ConfigDict(frozen=True)

    num_sectors: Whole = Field(default=8, ge=1)
    num_values_per_sector: Whole = Field(default=8, ge=1)
    clipping_dist: Number = Field(default=2.0, ge=0.15, le=12.0)
    """Metres."""

    @field_validator("num_sectors")
    @classmethod
    def _divides_the_rays(cls, number: int) -> int:
        if 64 % number:
            raise BadValue("is not a divisor of 64", "Write a divisor of 64, such as 8.")
        return number


class _File(BaseModel):
    """Defaults are the reference simulator's."""

    action_space_type: Annotated[SpaceType, choice(SpaceType)] = "discrete"
    training_algorithm: Annotated[str, choice(ALGORITHMS)] = "clipped_ppo"
    neural_network: Annotated[Network, choice(Network)] = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
    sensor: Annotated[tuple[str, ...], BeforeValidator(_sensors)] = ("observation",)
    version: Annotated[str, BeforeValidator(_version)] = "1.0"
    lidar_config: LidarConfig = LidarConfig()


class _Discrete(_File):
    action_space: list[Action] = Field(min_length=1)


class _Continuous(_File):
    action_space: Ranges


@dataclass(frozen=True)
class ModelMetadata:
    """What a model is made of.

    Attributes:
        version: Of the car, `1` to `6`.
        action_space_json: As written.
        problems: Warnings.
    """

    action_space: ActionSpace
    training_algorithm: str
    neural_network: Network
    sensor: tuple[str, ...]
    version: str
    lidar: LidarConfig
    action_space_json: str
    problems: tuple[Problem, ...]

    @staticmethod
    def from_bytes(data: bytes, name: str = "model_metadata.json") -> "ModelMetadata":
        """Raises ProblemsError if a value is missing, unknown or does not fit."""
        return _read(read_json_object(data, name, "V-03"))

    @property
    def eyes(self) -> int:
        return eyes_of(self.sensor)

    @property
    def scan_dims(self) -> int:
        """Source: the reference simulator's filters."""
        configured = self.lidar.num_sectors * self.lidar.num_values_per_sector
        return sum(SENSORS[name].values or configured for name in self.sensor if name in LIDARS)

    @property
    def algorithm(self) -> Algorithm:
        return algorithm_named(self.training_algorithm)

    @property
    def action_space_type(self) -> SpaceType:
        return "continuous" if self.action_space.continuous else "discrete"


def _read(file: JsonFile) -> ModelMetadata:
    values = {"version": "2.0" if "sensor" in file.values else "1.0", **file.values}
    if not any(name in str(values.get("sensor")) for name in CONFIGURED_LIDARS):
        values.pop("lidar_config", None)  # it is only used with these sensors
    continuous = isinstance(values.get("action_space"), dict)
    problems = [*_unknown_keys(file), *_other_type(file)]

    def rule_of(path: KeyPath) -> str:
        return "V-31" if path[0] == "action_space" and continuous else RULES[str(path[0])]

    read: _Discrete | _Continuous
    try:
        read = (_Continuous if continuous else _Discrete).model_validate(values)
    except ValidationError as error:
        examples = _RANGE_EXAMPLES if continuous else _LIST_EXAMPLES
        refuse([*problems, *problems_of(error, file, rule_of, _LIDAR_EXAMPLES | examples)])
        raise
    if isinstance(read, _Continuous):
        steering, speed = read.action_space.steering_angle, read.action_space.speed
        space = ActionSpace(low=(steering.low, speed.low), high=(steering.high, speed.high))
        problems += range_problems(file, read.action_space)
    else:
        space = ActionSpace(tuple((a.steering_angle, a.speed) for a in read.action_space))
        problems += list_problems(file, read.action_space)
    problems += [*_contradictions(file, read), *_unused_keys(file, read, ())]
    refuse(problems)
    return ModelMetadata(
        action_space=space,
        training_algorithm=read.training_algorithm,
        neural_network=read.neural_network,
        sensor=("observation",) if float(read.version) < 2 else read.sensor,
        version=read.version,
        lidar=read.lidar_config,
        action_space_json=json.dumps(values["action_space"]),
        problems=tuple(problems),
    )


def _other_type(file: JsonFile) -> Iterator[Problem]:
    space = file.values.get("action_space")
    kind, name = ("continuous", "ranges") if isinstance(space, dict) else ("discrete", "a list")
    stated = str(file.values.get("action_space_type", "discrete")).strip().casefold()
    if isinstance(space, list | dict) and stated in get_args(SpaceType) and stated != kind:
        what = f"action_space is {name}, but action_space_type is {stated}."
        remedy = f'Write "action_space_type": "{kind}", or {stated} actions.'
        yield file.problem("V-36", ("action_space",), what, remedy)


def _contradictions(file: JsonFile, read: _Discrete | _Continuous) -> Iterator[Problem]:
    name = read.training_algorithm
    if ALGORITHMS[name].ranges_only and isinstance(read, _Discrete):
        what = f'training_algorithm="{name}" needs continuous actions.'
        remedy = (
            'Write "action_space_type": "continuous" with ranges, '
            'or "training_algorithm": "clipped_ppo".'
        )
        yield file.problem("V-34", ("training_algorithm",), what, remedy)
    if float(read.version) < 2 and read.sensor != ("observation",):
        what = f"version {float(read.version):g} has one camera; its sensor list is ignored."
        remedy = 'Write "version": "5", or remove the sensors.'
        yield file.problem("V-33", ("sensor",), what, remedy, "warning")


def _unknown_keys(file: JsonFile) -> Iterator[Problem]:
    """One like a known key is probably misspelt."""
    for key, written in file.values.items():
        if key in RULES:
            continue
        meant = closest(key, RULES, cutoff=0.75)
        if meant is None:
            what, remedy = f"{shown(key)} is not used.", "Keep or remove it."
            yield file.problem("V-03", (key,), what, remedy, "warning", "keys are not used")
        else:
            what = f"{shown(key)}={as_written(written)} is not a known key."
            yield file.problem("V-03", (key,), what, f"Did you mean {meant}?")


def _unused_keys(file: JsonFile, value: Any, path: KeyPath) -> Iterator[Problem]:
    if isinstance(value, list):
        for number, item in enumerate(value):
            yield from _unused_keys(file, item, (*path, number))
    if isinstance(value, BaseModel):
        for key in value.model_extra or {}:
            what, remedy = f"{dotted((*path, key))} is not used.", "Keep or remove it."
            several = "keys are not used"
            yield file.problem("V-03", (*path, key), what, remedy, "warning", several)
        for key in type(value).model_fields:
            yield from _unused_keys(file, getattr(value, key), (*path, key))

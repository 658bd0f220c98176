"""curriculum.yaml: the stages of a training, checked as far as it alone tells."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from drcli.base.errors import BadValue, Problem, closest, refuse, shown
from drcli.model.files.data_file import (
    JsonFile,
    KeyPath,
    Number,
    Whole,
    as_written,
    dotted,
    problems_of,
    read_yaml_object,
)
from drcli.records.stage import StageGoal

RULE = "V-60"
"""Broken by all problems but wrong hyperparameters."""

MOST_STAGES = 100
_REMEDY = "Compare it with the one that `dr-init --curriculum` writes."

_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9 ._-]{0,38}[A-Za-z0-9._-])?")

OF_THE_MODEL = (
    "model_metadata",
    "action_space",
    "action_space_type",
    "neural_network",
    "sensor",
    "training_algorithm",
)
"""The weights fit only one of each."""

Model = TypeVar("Model", bound=BaseModel)


def _text(written: Any) -> str:
    if isinstance(written, bool) or not isinstance(written, str | int | float):
        raise BadValue("is not a text", "Write a text.")
    text = str(written).strip()
    if not text or not text.isprintable():
        raise BadValue("is empty", "Write a text, or leave the key out.")
    return text


def _name(written: Any) -> str:
    text = _text(written)
    if not _NAME.fullmatch(text):
        remedy = "Write up to 40 letters, digits, spaces and . _ -, such as wide-oval."
        raise BadValue("cannot be the name of a stage", remedy)
    return text


def _positive(written: Any) -> Any:
    if isinstance(written, bool) or not isinstance(written, int | float):
        raise BadValue("is not a number", "Write a number above 0, such as 20.")
    if not 0 < written <= 10_000_000:
        raise BadValue("is not above 0, or far too large", "Write a number above 0, such as 20.")
    return written


def _hyperparameters(written: Any) -> dict[str, Any] | str:
    if isinstance(written, str) and written.strip():
        return written.strip()
    if isinstance(written, dict) and all(isinstance(key, str) for key in written):
        return written
    remedy = "Write keys as in {lr: 0.0001}, or the name of a file such as stage-2.json."
    raise BadValue("is neither hyperparameters nor the name of a file", remedy)


def _settings(written: Any) -> dict[str, str]:
    remedy = "Write settings by name, as in {DR_TRAIN_REVERSE_DIRECTION: True}."
    if not isinstance(written, dict):
        raise BadValue("has no settings by name", remedy)
    for key, value in written.items():
        if not isinstance(key, str) or not isinstance(value, str | int | float | bool):
            raise BadValue("has a setting that is not a text, a number, True or False", remedy)
    return {key: str(value) for key, value in written.items()}


_Text = Annotated[str, BeforeValidator(_text)]
_Positive = Annotated[float, BeforeValidator(_positive)]
_Count = Annotated[Whole, Field(ge=1)]


class _Goal(BaseModel):
    model_config = ConfigDict(frozen=True)

    laps: Annotated[Whole, Field(ge=1, le=1000)] | None = None
    lap_time: _Positive | None = None
    progress: Annotated[Number, Field(ge=1, le=100)] | None = None
    evaluations: Annotated[Whole, Field(ge=1, le=100)] = 1
    mean_reward: Number | None = None
    steps: _Count | None = None
    episodes: _Count | None = None
    iterations: _Count | None = None
    minutes: _Positive | None = None


class StageEntry(BaseModel):
    """As written; the rest is as in run.env and custom_files/."""

    model_config = ConfigDict(frozen=True)

    name: Annotated[str, BeforeValidator(_name)]
    world: _Text | None = None
    race_type: _Text | None = None
    reward_function: _Text | None = None
    hyperparameters: Annotated[dict[str, Any] | str, BeforeValidator(_hyperparameters)] = {}
    settings: Annotated[dict[str, str], BeforeValidator(_settings)] = {}
    goal: _Goal = _Goal()

    @property
    def stage_goal(self) -> StageGoal:
        return StageGoal(**self.goal.model_dump())


class _File(BaseModel):
    model_config = ConfigDict(frozen=True)

    stages: Annotated[list[StageEntry], Field(min_length=1)]


EXAMPLES = {
    "stages": [{"name": "wide", "world": "oval"}],
    "name": "wide",
    "laps": 5,
    "lap_time": 12.5,
    "progress": 95,
    "evaluations": 3,
    "mean_reward": 300,
    "steps": 100_000,
    "episodes": 500,
    "iterations": 30,
    "minutes": 20,
}


@dataclass(frozen=True)
class CurriculumFile:
    file: JsonFile
    stages: tuple[StageEntry, ...]

    @staticmethod
    def from_bytes(data: bytes, name: str = "curriculum.yaml") -> "CurriculumFile":
        """Raises ProblemsError if not YAML, or a key or value is wrong."""
        file = read_yaml_object(data, name, RULE, "stages", _REMEDY)
        problems = list(_unknown_keys(file))
        try:
            read = _File.model_validate(file.values)
        except ValidationError as error:
            known = [*problems, *problems_of(error, file, lambda _: RULE, EXAMPLES)]
            refuse(known)
            raise
        refuse([*problems, *_contradictions(file, read.stages)])
        return CurriculumFile(file, tuple(read.stages))

    def problem(self, index: int, key: str, message: str, remedy: str) -> Problem:
        """Stages count from 0; parts of a key follow dots."""
        return self.file.problem(RULE, ("stages", index, *key.split(".")), message, remedy)


def _contradictions(file: JsonFile, stages: list[StageEntry]) -> Iterator[Problem]:
    if len(stages) > MOST_STAGES:
        what = f"stages has {len(stages)} entries; at most {MOST_STAGES} are allowed."
        yield file.problem(RULE, ("stages",), what, "Put some of them together.")
    first: dict[str, int] = {}
    for index, stage in enumerate(stages):
        path = ("stages", index, "name")
        if stage.name in first:
            what = (
                f"{dotted(path)}={as_written(stage.name)} is also the name of stage "
                f"{first[stage.name] + 1}."
            )
            remedy = "Give each stage a name of its own: a resumed training finds its stage by it."
            yield file.problem(RULE, path, what, remedy)
        first.setdefault(stage.name, index)
        if stage.stage_goal.empty and index < len(stages) - 1:
            what = f"Stage {index + 1} ({stage.name}) has no goal, so the next one never begins."
            remedy = "Add one, as in goal: {laps: 5, minutes: 20}."
            yield file.problem(RULE, ("stages", index, "goal"), what, remedy)


_KEYS: Mapping[str, tuple[str, ...]] = {
    "": tuple(_File.model_fields),
    "stage": tuple(StageEntry.model_fields),
    "goal": tuple(_Goal.model_fields),
}


def _unknown_keys(file: JsonFile) -> Iterator[Problem]:
    places: list[tuple[KeyPath, str, Any]] = [((), "", file.values)]
    stages = file.values.get("stages")
    for index, stage in enumerate(stages if isinstance(stages, list) else ()):
        places.append((("stages", index), "stage", stage))
        if isinstance(stage, dict):
            places.append((("stages", index, "goal"), "goal", stage.get("goal")))
    for path, kind, values in places:
        for key in values if isinstance(values, dict) else ():
            if key in _KEYS[kind]:
                continue
            written = shown(str(key))
            at = (*path, key) if isinstance(key, str | int) else path
            if key in OF_THE_MODEL:
                what = f"{dotted(at)} cannot change from stage to stage: the weights only fit one."
                remedy = "Remove it; model_metadata.json holds for all stages."
            else:
                meant = closest(written, _KEYS[kind])
                hint = f"Did you mean {meant}? " if meant is not None else ""
                what = f"{dotted(at) or written} is not a key of curriculum.yaml."
                remedy = f"{hint}The keys here are {', '.join(_KEYS[kind])}."
            yield file.problem(RULE, at, what, remedy)


def merged_hyperparameters(whole: bytes, changes: Mapping[str, Any]) -> bytes:
    values = json.loads(whole.decode("utf-8-sig"))
    return json.dumps({**values, **changes}, indent=2).encode()

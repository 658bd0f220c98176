"""Reads the small files of a model, such as its hyperparameters."""

import json
import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from drcli.analysis.model_source import ModelSource
from drcli.analysis.read_traces import simulation_logs
from drcli.base.errors import DrError
from drcli.base.json_record import RecordError
from drcli.bucket.bucket import Bucket
from drcli.config.value_types import USUAL_CAR
from drcli.model import keys
from drcli.model.files.action_space import ActionSpace
from drcli.records.training_record import StartSpending, TrainingStart

SETTINGS = "settings"
_PLACES = {
    keys.REWARD_FUNCTION_FILE: ("reward_function.py",),
    keys.HYPERPARAMETERS_FILE: ("ip/hyperparameters.json", "hyperparameters.json"),
    keys.MODEL_METADATA_FILE: ("model/model_metadata.json", "model_metadata.json"),
}
_WORLD = re.compile(r"^\s*['\"]?WORLD_NAME['\"]?\s*:\s*['\"]?([^'\",\s]+)", re.MULTILINE)
_LOG_WORLD = re.compile(r"(?:/WORLD_NAME: |'WORLD_NAME': ')([\w.-]+)")
_TEXT_BYTES = 1 << 20
_LOG_START_BYTES = 4 << 20
_LINE_START = re.compile(r"^\s*(?:\[[^\]\n]*\]\s+)+", re.MULTILINE)
"""What the launcher of DeepRacer on AWS puts before each line."""

_OWN_CAR = ("DR_CAR_STEERING_", "DR_CAR_MAX_SPEED", "DR_CAR_BATTERY")
_LOGGED_ACTIONS = re.compile(r"ction space from file: (.+)")
_LOGGED_PARAMETERS = re.compile(r"Using the following hyper-parameters\s*(\{.*?\})", re.DOTALL)


@dataclass(frozen=True)
class ModelFacts:
    """What small files tell; None stands for unknown.

    Attributes:
        parent: The model that this one was started from.
        files: The racer's files and the settings as text, by name.
        car: Name of the car's set; None also for a car of one's own.
    """

    hyperparameters: Mapping[str, object] = field(default_factory=dict)
    actions: ActionSpace | None = None
    world: str | None = None
    evaluation_world: str | None = None
    parent: str | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    parent_files: Mapping[str, str] = field(default_factory=dict)
    machine_hours: float | None = None
    cost_usd: float | None = None
    car: str | None = None

    @property
    def episodes_per_iteration(self) -> int:
        written = self.hyperparameters.get("num_episodes_between_training")
        return written if isinstance(written, int) and written > 0 else 20


def model_facts(source: ModelSource, problems: list[str]) -> ModelFacts:
    """Read them; what is damaged becomes a problem."""
    texts = _Texts(source, problems)
    log = texts.log_start()
    parameters = texts.json(_PLACES[keys.HYPERPARAMETERS_FILE])
    if parameters is None and (found := _LOGGED_PARAMETERS.search(log)):
        parameters = _json_or_none(found[1])
    metadata = texts.json(_PLACES[keys.MODEL_METADATA_FILE])
    written = metadata.get("action_space") if isinstance(metadata, dict) else None
    if written is None and (logged := _LOGGED_ACTIONS.findall(log)):
        written = _json_or_none(logged[-1].replace("'", '"'))
    start, files = _files_of_racer(texts.read)
    parent = start.pretrained.prefix if start is not None and start.pretrained else None
    hours, usd = _spending(source)
    world = world_in_parameters(texts.training_parameters()) or world_in_log(log)
    settings = None if start is None else start.settings
    return ModelFacts(
        hyperparameters=parameters if isinstance(parameters, dict) else {},
        actions=actions_of(written),
        world=world or str((settings or {}).get("DR_WORLD_NAME", "")) or None,
        evaluation_world=world_in_parameters(texts.read("evaluation_params.yaml")),
        parent=parent,
        files=files,
        parent_files=_parent_files(source, parent),
        machine_hours=hours,
        cost_usd=usd,
        car=_car(settings),
    )


def actions_of(written: Any) -> ActionSpace | None:
    """The action space in model_metadata.json; None if it cannot be understood.

    Strangers' files may have actions that none of our cars can do.
    """
    try:
        if isinstance(written, dict):
            ranges = [written[name] for name in ("steering_angle", "speed")]
            low, high = ([float(each[end]) for each in ranges] for end in ("low", "high"))
            return ActionSpace(low=(low[0], low[1]), high=(high[0], high[1]))
        pairs = [(float(each["steering_angle"]), float(each["speed"])) for each in written]
    except (KeyError, TypeError, ValueError, IndexError):
        return None
    if not pairs or not all(math.isfinite(number) for pair in pairs for number in pair):
        return None
    return ActionSpace(values=tuple(pairs))


class _Texts:
    def __init__(self, source: ModelSource, problems: list[str]) -> None:
        self._source = source
        self._problems = problems

    def read(self, name: str, limit: int = _TEXT_BYTES) -> str:
        real = self._source.files.others.get(name)
        if real is None:
            return ""
        try:
            return self._source.objects.read(real)[:limit].decode("utf-8", "replace")
        except DrError as error:
            self._problems.append(f"{real} cannot be read: {error}")
            return ""

    def json(self, names: tuple[str, ...]) -> Any:
        for name in names:
            if name in self._source.files.others:
                text = self.read(name)
                found = _json_or_none(text)
                if not isinstance(found, dict):
                    real = self._source.files.others[name]
                    self._problems.append(f"{real} is damaged: it is not a JSON object.")
                    return None
                return found
        return None

    def training_parameters(self) -> str:
        found = self.read("training_params.yaml")
        return found or self.read("training_params_1.yaml")

    def log_start(self) -> str:
        logs = simulation_logs(self._source.files.others)
        if not logs:
            return ""
        return _LINE_START.sub("", self.read(logs[-1][0], _LOG_START_BYTES))


def _files_of_racer(read: Callable[[str], str]) -> tuple[TrainingStart | None, dict[str, str]]:
    """The record of the start, and the files and settings as text."""
    start = None
    with suppress(RecordError):  # it only adds what other files lack
        start = TrainingStart.decode(read("ip/run.json").encode())
    found = {name: next(filter(None, map(read, places)), "") for name, places in _PLACES.items()}
    settings = (start.settings if start is not None else None) or {}
    found[SETTINGS] = "".join(f"{name}={value}\n" for name, value in sorted(settings.items()))
    return start, {name: text for name, text in found.items() if text}


def _car(settings: Mapping[str, Any] | None) -> str | None:
    if settings is None or any(name.startswith(_OWN_CAR) for name in settings):
        return None
    return str(settings.get("DR_SIM_CAR", USUAL_CAR))


def _parent_files(source: ModelSource, parent: str | None) -> dict[str, str]:
    if parent is None or source.bucket is None:
        return {}
    return _files_of_racer(partial(_object_or_empty, source.bucket, keys.folder(parent)))[1]


def _object_or_empty(bucket: Bucket, folder: str, name: str) -> str:
    try:
        return bucket.get(folder + name)[:_TEXT_BYTES].decode("utf-8", "replace")
    except DrError:
        return ""


def _spending(source: ModelSource) -> tuple[float | None, float | None]:
    if source.bucket is None or not source.prefix:
        return None, None
    hours, usd = [], []
    try:
        for info in source.bucket.list(keys.spending_folder(source.prefix)):
            try:
                one = StartSpending.decode(source.bucket.get(info.key))
            except RecordError:
                continue
            hours.append(one.hours)
            usd += [one.usd] if one.usd is not None else []
    except DrError:
        return None, None
    return (sum(hours) if hours else None), (sum(usd) if usd else None)


def _json_or_none(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def world_in_parameters(text: str) -> str | None:
    """The track in training_params.yaml or evaluation_params.yaml."""
    found = _WORLD.search(text)
    if found is None:
        return None
    first = found[1].strip("[]- ")
    return first or None


def world_in_log(text: str) -> str | None:
    found = _LOG_WORLD.search(text)
    return found[1] if found else None

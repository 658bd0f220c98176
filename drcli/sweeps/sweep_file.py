"""sweep.yaml: what trainings vary, and when they end."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from drcli.base.errors import BadValue, Problem, SettingsError, closest, refuse, shown
from drcli.config.fields import GENERAL_RULE as RULE
from drcli.config.settings import catalogue
from drcli.model.files.data_file import (
    JsonFile,
    KeyPath,
    Number,
    Whole,
    dotted,
    problems_of,
    read_yaml_object,
)
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.sweeps.sweep_record import Metric, Resource

MOST_TRIALS = 200
"""More were probably not meant."""

_REMEDY = "Compare it with the one that `dr-sweep init` writes."

_NAME = re.compile(r"[a-z0-9](?:[a-z0-9-]{0,38}[a-z0-9])?")

OWN_SETTINGS = (
    "DR_RUN_ID",
    "DR_EXPERIMENT_NAME",
    "DR_LOCAL_S3_MODEL_PREFIX",
    "DR_LOCAL_S3_METRICS_PREFIX",
    "DR_LOCAL_S3_CUSTOM_FILES_PREFIX",
    "DR_MODEL_DESCRIPTION",
    "DR_LAUNCHER",
)
Method = Literal["none", "halving", "asha", "population"]
Search = Literal["grid", "random"]
RESOURCES: tuple[Resource, ...] = get_args(Resource)


def _one_of(*words: str) -> BeforeValidator:
    def check(written: Any) -> Any:
        if written in words:
            return written
        listed = ", ".join(words[:-1]) + f" or {words[-1]}"
        raise BadValue("is not a known word", f"Write {listed}.")

    return BeforeValidator(check)


def _name(written: Any) -> str:
    text = str(written)
    if isinstance(written, bool) or not _NAME.fullmatch(text):
        remedy = "Write up to 40 small letters, digits and -, such as first-sweep."
        raise BadValue("cannot be the name of a sweep", remedy)
    return text


def _paths(written: Any) -> list[str]:
    entries = written if isinstance(written, list) else [written]
    if not entries or not all(isinstance(each, str) and each.strip() for each in entries):
        raise BadValue("does not name files", "Write a list, as in [a.py, rewards/b.py].")
    return [each.strip() for each in entries]


def _positive(written: Any) -> Any:
    if isinstance(written, bool) or not isinstance(written, int | float):
        raise BadValue("is not a number", "Write a number above 0, such as 20.")
    if not 0 < written <= 1_000_000_000:
        raise BadValue("is not above 0, or far too large", "Write a number above 0, such as 20.")
    return written


def _choices(written: Any) -> Any:
    """A list, a single value, or a range {min, max}."""
    if isinstance(written, dict):
        return _range(written)
    values = written if isinstance(written, list) else [written]
    if not values or not all(isinstance(each, str | int | float) for each in values):
        remedy = "Write a list, as in [0.0003, 0.001], or a range, as in {min: 0.0001, max: 0.001}."
        raise BadValue("is neither values nor a range", remedy)
    return values


def _range(written: dict[Any, Any]) -> "Span":
    remedy = "Write {min: 0.0001, max: 0.001}, and log: true to draw from all sizes alike."
    ends = [written.get(end) for end in ("min", "max")]
    wrong = set(written) - {"min", "max", "log"} or not isinstance(written.get("log", False), bool)
    if wrong or not all(type(end) in (int, float) for end in ends):
        raise BadValue("is not a range", remedy)
    low, high = (end for end in ends if end is not None)
    if not low < high or (written.get("log") and low <= 0):
        raise BadValue("is an empty range, or one with log that does not begin above 0", remedy)
    return Span(low, high, written.get("log", False))


@dataclass(frozen=True)
class Span:
    """A range; of whole numbers if both ends are.

    Attributes:
        log: Whether 0.001 to 0.01 is as likely as 0.01 to 0.1.
    """

    low: float
    high: float
    log: bool = False


Choices = list[str | int | float] | Span

_Choices = Annotated[Any, BeforeValidator(_choices)]
_Positive = Annotated[float, BeforeValidator(_positive)]
_Count = Annotated[Whole, Field(ge=1)]


class Vary(BaseModel):
    """See docs/sweeps.md."""

    model_config = ConfigDict(frozen=True)

    reward_function: Annotated[list[str], BeforeValidator(_paths)] = []
    model_metadata: Annotated[list[str], BeforeValidator(_paths)] = []
    hyperparameters: dict[str, _Choices] = {}
    settings: dict[str, _Choices] = {}
    seed: list[Annotated[Whole, Field(ge=0)]] = []


class Budget(BaseModel):
    """The most of one resource for each training."""

    model_config = ConfigDict(frozen=True)

    minutes: _Positive | None = None
    steps: _Count | None = None
    episodes: _Count | None = None
    iterations: _Count | None = None

    @property
    def resource(self) -> Resource:
        return next(name for name in RESOURCES if getattr(self, name) is not None)

    @property
    def most(self) -> float:
        return float(getattr(self, self.resource))


class EarlyStopping(BaseModel):
    """Which trainings end early.

    Attributes:
        first_check: Share of the budget.
        reduction_factor: One of so many goes on at each check; amounts grow by it, too.
        every: Share of the budget between a population's checks.
        quantile: Share of a population that is replaced; as many are copied.
    """

    model_config = ConfigDict(frozen=True)

    method: Annotated[Method, _one_of("none", "halving", "asha", "population")] = "none"
    first_check: Annotated[Number, Field(ge=0.01, le=0.99)] = 0.25
    reduction_factor: Annotated[Number, Field(ge=1.1, le=10)] = 1.5
    every: Annotated[Number, Field(ge=0.01, le=0.5)] = 0.2
    quantile: Annotated[Number, Field(ge=0.05, le=0.5)] = 0.25

    @property
    def halves(self) -> bool:
        return self.method in ("halving", "asha")


class SweepPlan(BaseModel):
    model_config = ConfigDict(frozen=True)

    name: Annotated[str, BeforeValidator(_name)] = ""
    vary: Vary
    settings: dict[str, str | int | float | bool] = {}
    search: Annotated[Search, _one_of("grid", "random")] = "grid"
    trials: Annotated[Whole, Field(ge=1, le=MOST_TRIALS)] | None = None
    seed: Annotated[Whole, Field(ge=0)] = 1
    budget: Budget
    until_laps: Annotated[Whole, Field(ge=1, le=1000)] | None = None
    until_lap_time: _Positive | None = None
    metric: Annotated[Metric, _one_of("lap_time", "progress", "reward")] = "lap_time"
    early_stopping: EarlyStopping = EarlyStopping()
    parallel: Annotated[Whole, Field(ge=1, le=100)] | None = None

    @property
    def goals(self) -> dict[str, float]:
        """As in `Job`."""
        asked = {"until_laps": self.until_laps, "until_lap_time_s": self.until_lap_time}
        return {key: value for key, value in asked.items() if value is not None}


EXAMPLES = {
    "vary": {"seed": [1, 2]},
    "budget": {"minutes": 20},
    "settings": {"DR_WORLD_NAME": "reinvent_base"},
    "hyperparameters": {"lr": [0.0003, 0.001]},
    "seed": [1, 2],
    "trials": 8,
    "minutes": 20,
    "steps": 50_000,
    "episodes": 500,
    "iterations": 30,
    "until_laps": 3,
    "until_lap_time": 12.5,
    "parallel": 2,
    "first_check": 0.25,
    "reduction_factor": 1.5,
    "every": 0.2,
    "quantile": 0.25,
}


@dataclass(frozen=True)
class SweepFile:
    name: str
    folder: Path
    file: JsonFile
    plan: SweepPlan

    def problem(self, path: KeyPath, message: str, remedy: str) -> Problem:
        return self.file.problem(RULE, path, message, remedy)


def read_sweep_file(path: Path) -> SweepFile:
    """Raises SettingsError for a missing file, ProblemsError for wrong content."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be read ({error.strerror or error}).",
            remedy="Name the file of the sweep; `dr-sweep init` writes an example.",
        ) from None
    file = read_yaml_object(data, path.name, RULE, "vary", _REMEDY)
    problems = list(_unknown_keys(file))
    values = {key: value for key, value in file.values.items() if value is not None}
    try:
        plan = SweepPlan.model_validate(values)
    except ValidationError as error:
        refuse([*problems, *problems_of(error, file, lambda _: RULE, EXAMPLES)])
        raise
    name = plan.name
    if not name:
        name = re.sub(r"[^a-z0-9]+", "-", path.stem.lower()).strip("-")[:40].strip("-") or "sweep"
    found = SweepFile(name, path.absolute().parent, file, plan)
    refuse([*problems, *_contradictions(found)])
    return found


_KEYS: Mapping[str, tuple[str, ...]] = {
    "": tuple(SweepPlan.model_fields),
    "vary": tuple(Vary.model_fields),
    "budget": tuple(Budget.model_fields),
    "early_stopping": tuple(EarlyStopping.model_fields),
}


def _unknown_keys(file: JsonFile) -> Iterator[Problem]:
    for section, known in _KEYS.items():
        values = file.values.get(section) if section else file.values
        for key in values if isinstance(values, dict) else ():
            if key not in known:
                path = (section, key) if section else (key,)
                meant = closest(str(key), known)
                hint = f"Did you mean {meant}? " if meant is not None else ""
                what = f"{dotted(path)} is not a key of a sweep."
                yield file.problem(RULE, path, what, f"{hint}The keys here are {', '.join(known)}.")


def _contradictions(found: SweepFile) -> Iterator[Problem]:
    plan, problem = found.plan, found.problem
    given = [name for name, value in plan.budget if value is not None]
    if len(given) != 1:
        what = f"budget has {' and '.join(given) or 'no limit'}; a training has one."
        yield problem(("budget",), what, f"Write one of {', '.join(Budget.model_fields)}.")
    if not any(value for _, value in plan.vary):
        what = "vary has nothing that differs between the trainings."
        yield problem(("vary",), what, "Add one, as in hyperparameters: {lr: [0.0003, 0.001]}.")
    if plan.search == "random" and plan.trials is None:
        what = "search=random does not say how many trainings to draw."
        yield problem(("search",), what, "Add their number, as in trials: 8.")
    if plan.search == "grid" and plan.trials is not None:
        what = f"trials={plan.trials} has no meaning for search=grid, which trains every one."
        yield problem(("trials",), what, "Remove it, or write search: random.")
    if plan.early_stopping.method == "population" and len(plan.vary.model_metadata) > 1:
        what = "early_stopping.method=population copies weights, which fit one model_metadata only."
        yield problem(("early_stopping", "method"), what, "Keep one file in vary.model_metadata.")
    yield from _names(found)
    yield from _twice(found)
    for section in ("hyperparameters", "settings"):
        for key, choices in getattr(plan.vary, section).items():
            if plan.search == "grid" and isinstance(choices, Span):
                path = ("vary", section, key)
                what = f"{dotted(path)} is a range, and search=grid trains all values."
                yield problem(path, what, "List the values, or write search: random.")


def _twice(found: SweepFile) -> Iterator[Problem]:
    vary, problem = found.plan.vary, found.problem
    lists: dict[KeyPath, Choices] = {
        ("vary", "reward_function"): list(vary.reward_function),
        ("vary", "model_metadata"): list(vary.model_metadata),
        ("vary", "seed"): list(vary.seed),
    }
    lists |= {("vary", "settings", key): values for key, values in vary.settings.items()}
    lists |= {
        ("vary", "hyperparameters", key): values for key, values in vary.hyperparameters.items()
    }
    for path, values in lists.items():
        if isinstance(values, Span):
            continue
        again = [value for index, value in enumerate(values) if value in values[:index]]
        if again:
            what = f"{dotted(path)} has {again[0]} twice."
            yield problem(path, what, "Remove one. To train it several times, vary seed.")


def _names(found: SweepFile) -> Iterator[Problem]:
    plan, problem = found.plan, found.problem
    known_settings = set(catalogue())
    for path, names in ((("settings",), plan.settings), (("vary", "settings"), plan.vary.settings)):
        for name in names:
            if name in OWN_SETTINGS:
                what = f"{dotted((*path, name))}: a sweep sets {name} itself."
                yield problem((*path, name), what, "Remove it.")
            elif name not in known_settings:
                meant = closest(name, known_settings)
                hint = f"Did you mean {meant}? " if meant is not None else ""
                what = f"{dotted((*path, name))}: {shown(name)} is not a setting."
                yield problem((*path, name), what, f"{hint}`dr docs settings` lists all.")
            elif path == ("settings",) and name in plan.vary.settings:
                what = f"settings.{name} is also in vary.settings."
                yield problem((*path, name), what, "Keep one of them.")
    known = set(Hyperparameters.model_fields) - {"problems"}
    for name in plan.vary.hyperparameters:
        if name not in known:
            meant = closest(name, known)
            hint = f"Did you mean {meant}? " if meant is not None else ""
            what = f"{dotted(('vary', 'hyperparameters', name))} is not a hyperparameter."
            remedy = f"{hint}`dr-explain` tells about all of them."
            yield problem(("vary", "hyperparameters", name), what, remedy)

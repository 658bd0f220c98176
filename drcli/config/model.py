"""All settings as one frozen object that can travel to another process."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, NoReturn

from drcli.base.problems import Place, Problem, few
from drcli.config.fields import Setting, declared
from drcli.config.groups.opponents import BotSettings, ObstacleSettings, OpponentSettings
from drcli.config.groups.race import EvaluationSettings, RaceSettings, TrainSettings
from drcli.config.groups.realism import RealismSettings
from drcli.config.groups.storage import BucketSettings, KeySettings
from drcli.config.groups.system import (
    ContainerSettings,
    DerivedSettings,
    ScreenSettings,
    ServiceSettings,
)
from drcli.config.setting_problems import setting_problem


@dataclass(frozen=True)
class Override:
    """What the file of one worker changes.

    Attributes:
        values: Texts by the name of the field.
        sources: Places by DR_ name.
    """

    values: Mapping[str, str]
    sources: Mapping[str, Place]


WORKER_NAMES = (
    "DR_WORLD_NAME",
    "DR_RACE_TYPE",
    "DR_CAR_COLOR",
    "DR_CAR_BODY_SHELL_TYPE",
    "DR_ENABLE_DOMAIN_RANDOMIZATION",
    "DR_RANDOMIZE_TEXTURES",
    "DR_TRAIN_CHANGE_START_POSITION",
    "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION",
    "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST",
    "DR_TRAIN_START_POSITION_OFFSET",
    "DR_TRAIN_REVERSE_DIRECTION",
    "DR_TRAIN_LANES",
    "DR_CAMERA_MAIN_ENABLE",
    "DR_CAMERA_SUB_ENABLE",
    "DR_ENABLE_EXTRA_KVS_OVERLAY",
)
"""Settings that worker-N.env may change, beside all that begin with one of the following."""

WORKER_STEMS = ("DR_OA_", "DR_H2B_", "DR_SIM_")


class Settings(
    DerivedSettings,
    ServiceSettings,
    ScreenSettings,
    ContainerSettings,
    RealismSettings,
    OpponentSettings,
    BotSettings,
    ObstacleSettings,
    KeySettings,
    BucketSettings,
    EvaluationSettings,
    TrainSettings,
    RaceSettings,
):
    """Every DR_ setting, checked. Only `load_settings` and `Settings.restore` make one.

    Attributes:
        directory: Folder with run.env and system.env, absolute.
        extra: Names in the files that are not settings, with their values.
        sources: Place at which each setting and each of those names was given; defaults are absent.
        problems: Warnings: what was accepted but looks odd.
        overrides: What worker-N.env changes, for the second worker first.
    """

    directory: Path
    extra: Mapping[str, str]
    sources: Mapping[str, Place]
    problems: tuple[Problem, ...]
    overrides: tuple[Override, ...]

    def __init__(
        self,
        *,
        directory: Path,
        extra: Mapping[str, str],
        sources: Mapping[str, Place],
        problems: tuple[Problem, ...],
        overrides: tuple[Override, ...] = (),
        **values: Any,
    ) -> None:
        fields = {setting.field: setting.default for setting in catalogue().values()}
        if unknown := values.keys() - fields.keys():
            raise TypeError(f"No setting is called {', '.join(sorted(unknown))}.")
        self.__dict__.update(
            fields | values,
            directory=directory,
            extra=extra,
            sources=sources,
            problems=problems,
            overrides=overrides,
        )

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"Settings are frozen; {name} is changed in a copy, by `replaced`.")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Settings) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]

    def replaced(self, **changes: Any) -> "Settings":
        """The same with other values for some fields."""
        return Settings(**{**vars(self), **changes})

    @property
    def custom_files_dir(self) -> Path:
        """Folder on this machine with the racer's own three files."""
        if not self.experiment_name:
            return self.directory / "custom_files"
        return self.directory / "experiments" / self.experiment_name / "custom_files"

    @property
    def tracks_folder(self) -> Path:
        """Folder with the racer's own route files; it need not exist."""
        return self.directory / (self.tracks_dir or "tracks")

    @property
    def warnings(self) -> tuple[str, ...]:
        """The problems as sentences."""
        return tuple(few(map(str, self.problems)))

    def place(self, name: str) -> Place:
        """Where a DR_ setting was given; the file is `default` where nobody gave it."""
        return self.sources.get(name, Place("default"))

    def source(self, name: str) -> str:
        """The place as text: `run.env line 7`, `environment`, `flag` or `default`."""
        return str(self.place(name))

    def unsupported(self, job: Literal["training", "evaluation"] = "training") -> Problem | None:
        """Why these settings cannot be run; None when they can."""
        if job == "evaluation":
            return None
        for worker in range(len(self.overrides) + 1):
            own = self.for_worker(worker)
            if own.race_type == "HEAD_TO_MODEL":
                return setting_problem(
                    "DR_RACE_TYPE",
                    own.place("DR_RACE_TYPE"),
                    "DR_RACE_TYPE=HEAD_TO_MODEL races two trained models; it is for evaluations "
                    "only.",
                    "Choose another DR_RACE_TYPE, or use `dr-evaluate`.",
                )
        return None

    def for_worker(self, worker: int) -> "Settings":
        """The settings of one simulation worker, counted from 0; the first one has these."""
        if not 1 <= worker <= len(self.overrides):
            return self
        own = self.overrides[worker - 1]
        return self.replaced(sources={**self.sources, **own.sources}, **typed(own.values))

    def plain(self) -> dict[str, Any]:
        """Every field as a value that JSON knows."""
        values = {name: _plain(value) for name, value in vars(self).items()}
        return {
            **values,
            "problems": [asdict(problem) for problem in self.problems],
            "overrides": [asdict(override) for override in self.overrides],
        }

    def dump(self) -> str:
        """All of it as JSON text for `restore`."""
        return json.dumps(self.plain())

    @staticmethod
    def restore(text: str) -> "Settings":
        """The settings that `dump` wrote down, in this or another process."""
        values = json.loads(text)
        for setting in catalogue().values():
            written = values[setting.field]
            if setting.kind == "path" and written is not None:
                values[setting.field] = Path(written)
            elif setting.kind == "list":
                values[setting.field] = tuple(map(tuple, written))
        values["directory"] = Path(values["directory"])
        values["sources"] = _places(values["sources"])
        values["problems"] = tuple(Problem(**problem) for problem in values["problems"])
        values["overrides"] = tuple(
            Override(each["values"], _places(each["sources"])) for each in values["overrides"]
        )
        return Settings(**values)


@cache
def catalogue() -> Mapping[str, Setting]:
    """What is known about every setting, by DR_ name, in the order of the documentation."""
    return declared(Settings)


def typed(texts: Mapping[str, str]) -> dict[str, Any]:
    """Values by field, for texts by field.

    Raises:
        BadValue: A text does not fit its setting.
    """
    by_field = {setting.field: setting for setting in catalogue().values()}
    return {field: by_field[field].read(text) for field, text in texts.items()}


def _places(written: Mapping[str, Any]) -> dict[str, Place]:
    """Places as JSON wrote them, by name."""
    return {name: Place(*place) for name, place in written.items()}


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value

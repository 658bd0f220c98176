"""The narrow values that the parts of a run are given, made of small groups of settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from drcli.base.json_record import from_json
from drcli.base.problems import Place, Problem
from drcli.config.bucket_config import (
    ModelConfig,
    StorageConfig,
)
from drcli.config.fields import FrozenGroups, declared
from drcli.config.groups.failures import FailureSettings
from drcli.config.groups.figures import FigureSettings
from drcli.config.groups.log_settings import LogSettings
from drcli.config.groups.opponents import BotSettings, ObstacleSettings, OpponentSettings
from drcli.config.groups.processor import ProcessorSettings
from drcli.config.groups.race import (
    EpisodeSettings,
    EvaluationSettings,
    RaceSettings,
)
from drcli.config.groups.realism import OwnCarSettings, RealismSettings
from drcli.config.groups.train_settings import TrainSettings
from drcli.config.groups.unattended import (
    CostSettings,
    InterruptionSettings,
    MessageSettings,
    TimedWorkSettings,
    WatchSettings,
)
from drcli.config.setting_problems import setting_problem

SUPERVISOR_ONLY = frozenset({*declared(MessageSettings), "DR_ON_END"})
"""Settings that no worker or command of a run needs. They hold addresses of people, and a command
that may contain anything, so no copy of a model tells them."""


class PlacedSettings(FrozenGroups):
    """Settings that know where each of them was given.

    Attributes:
        directory: Folder with run.env and system.env, absolute.
        sources: Place at which each setting was given; defaults are absent.
    """

    directory: Path
    sources: Mapping[str, Place]
    tracks_dir: Path | None

    @property
    def tracks_folder(self) -> Path:
        """Folder with the racer's own route files; it need not exist."""
        return self.directory / (self.tracks_dir or "tracks")

    def place(self, name: str) -> Place:
        """Where a DR_ setting was given; the file is `default` where nobody gave it."""
        return self.sources.get(name, Place("default"))

    def source(self, name: str) -> str:
        """The place as text: `run.env line 7`, `environment`, `flag` or `default`."""
        return str(self.place(name))


class RaceConfig(
    PlacedSettings,
    RaceSettings,
    EpisodeSettings,
    ObstacleSettings,
    BotSettings,
    RealismSettings,
    OwnCarSettings,
):
    """What one simulation worker drives: track, race, starts of episodes, sim-to-real extras."""

    @property
    def untrainable(self) -> Problem | None:
        """Why no model can be trained in this race; None where one can."""
        if self.race_type != "HEAD_TO_MODEL":
            return None
        return setting_problem(
            "DR_RACE_TYPE",
            self.place("DR_RACE_TYPE"),
            "DR_RACE_TYPE=HEAD_TO_MODEL races two trained models; it is for evaluations only.",
            "Choose another DR_RACE_TYPE, or use `dr-evaluate`.",
        )

    def to_json(self) -> dict[str, Any]:
        """The texts by field, the folder and the places."""
        folder = str(self.directory)
        return super().to_json() | {"directory": folder, "sources": dict(self.sources)}

    @classmethod
    def from_json(cls, value: Any) -> Self:
        """Read what `to_json` made, and check every value.

        Raises:
            RecordError: Something is missing or its value is not allowed.
        """
        return cls(**cls.values_of(value), **vars(from_json(_Places, value)))


@dataclass(frozen=True)
class _Places:
    directory: Path
    sources: Mapping[str, Place]


class TrainConfig(FrozenGroups, TrainSettings, FailureSettings, ProcessorSettings):
    """How to train: workers, goals, evaluations during the training, failures, the processor."""


class EvaluationConfig(FrozenGroups, EvaluationSettings, OpponentSettings):
    """How to evaluate, and against which model."""


class UnattendedConfig(
    FrozenGroups,
    InterruptionSettings,
    TimedWorkSettings,
    CostSettings,
    WatchSettings,
    MessageSettings,
):
    """What happens to a training that nobody watches."""


class LogConfig(FrozenGroups, LogSettings):
    """The logs of a run: their size, their form, and whether they also go to CloudWatch."""


class FigureConfig(FrozenGroups, FigureSettings):
    """Where else the figures of a training go while it runs."""


@dataclass(frozen=True)
class WebConfig:
    """Where the console listens.

    Attributes:
        port_place: Where DR_WEBVIEWER_PORT was given.
        asks_token: Whether who opens it needs its token.
    """

    host: str
    port: int
    port_place: Place
    asks_token: bool = True

    @property
    def is_chosen(self) -> bool:
        """Whether somebody has chosen the port."""
        return self.port_place.file != "default"


@dataclass(frozen=True)
class RunConfig:
    """Everything that the processes of a training or an evaluation need to know.

    Attributes:
        races: For the first worker, and for all others that have a race of their own.
        given: The settings that somebody has given, without secrets, as texts by DR_ name: for
            commands that the run calls while the files may be edited for another training.
        eval_world_place: Where DR_TRAIN_EVAL_WORLD was given.
        live_view: Whether workers show what they do to viewers on this machine.
    """

    run_id: int
    directory: Path
    logs: LogConfig
    model: ModelConfig
    storage: StorageConfig
    train: TrainConfig
    evaluation: EvaluationConfig
    unattended: UnattendedConfig
    figures: FigureConfig
    races: tuple[RaceConfig, ...]
    eval_world_place: Place = field(default_factory=lambda: Place("default"))
    given: Mapping[str, str] = field(default_factory=dict)
    live_view: bool = True

    def race(self, worker: int = 0) -> RaceConfig:
        """What a simulation worker drives, counted from 0."""
        return self.races[worker if worker < len(self.races) else 0]

    def second_race(self, race: RaceConfig) -> RaceConfig | None:
        """The same race on DR_TRAIN_EVAL_WORLD; None without that second track."""
        return on_world(race, self.train.train_eval_world, self.eval_world_place)


def on_world(race: RaceConfig, world: str, place: Place) -> RaceConfig | None:
    """A race on another track, whose name was given at that place; None without a name."""
    if not world:
        return None
    return race.replaced(world_name=world, sources={**race.sources, "DR_WORLD_NAME": place})

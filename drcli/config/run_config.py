"""The narrow values that the parts of a run are given."""

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
"""Addresses and a command that no copy of a model tells."""


class PlacedSettings(FrozenGroups):
    """Settings with the places at which they were given."""

    directory: Path
    sources: Mapping[str, Place]
    tracks_dir: Path | None

    @property
    def tracks_folder(self) -> Path:
        return self.directory / (self.tracks_dir or "tracks")

    def place(self, name: str) -> Place:
        """The file is `default` where nobody gave it."""
        return self.sources.get(name, Place("default"))

    def source(self, name: str) -> str:
        """`run.env line 7`, `environment`, `flag` or `default`."""
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
    """What one simulation worker drives."""

    @property
    def untrainable(self) -> Problem | None:
        if self.race_type != "HEAD_TO_MODEL":
            return None
        return setting_problem(
            "DR_RACE_TYPE",
            self.place("DR_RACE_TYPE"),
            "DR_RACE_TYPE=HEAD_TO_MODEL races two trained models; it is for evaluations only.",
            "Choose another DR_RACE_TYPE, or use `dr-evaluate`.",
        )

    def to_json(self) -> dict[str, Any]:
        folder = str(self.directory)
        return super().to_json() | {"directory": folder, "sources": dict(self.sources)}

    @classmethod
    def from_json(cls, value: Any) -> Self:
        """Read and check what `to_json` made.

        Raises:
            RecordError: Something is missing or its value is not allowed.
        """
        return cls(**cls.values_of(value), **vars(from_json(_Places, value)))


@dataclass(frozen=True)
class _Places:
    directory: Path
    sources: Mapping[str, Place]


class TrainConfig(FrozenGroups, TrainSettings, FailureSettings, ProcessorSettings):
    """How to train."""


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
    """For a training that nobody watches."""


class LogConfig(FrozenGroups, LogSettings):
    """The logs of a run."""


class FigureConfig(FrozenGroups, FigureSettings):
    """Where the figures of a training go."""


@dataclass(frozen=True)
class WebConfig:
    """Where the console listens."""

    host: str
    port: int
    port_place: Place
    asks_token: bool = True

    @property
    def is_chosen(self) -> bool:
        return self.port_place.file != "default"


@dataclass(frozen=True)
class RunConfig:
    """Everything that the processes of a run need to know.

    Attributes:
        given: Without secrets: for commands that the run calls while the files may be edited.
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
        """Of a worker, counted from 0."""
        return self.races[worker if worker < len(self.races) else 0]

    def second_race(self, race: RaceConfig) -> RaceConfig | None:
        return on_world(race, self.train.train_eval_world, self.eval_world_place)


def on_world(race: RaceConfig, world: str, place: Place) -> RaceConfig | None:
    """A race on another track; None without a name."""
    if not world:
        return None
    return race.replaced(world_name=world, sources={**race.sources, "DR_WORLD_NAME": place})

"""The narrow values that the parts of a run are given."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self
from urllib.parse import urlsplit

from drcli.base.errors import Place, Problem
from drcli.base.files import without_dots
from drcli.base.json_record import SafeInt, from_json
from drcli.config.fields import FrozenGroups, declared, setting_problem
from drcli.config.groups.race import (
    BotSettings,
    EpisodeSettings,
    EvaluationSettings,
    ObstacleSettings,
    OpponentSettings,
    OwnCarSettings,
    RaceSettings,
    RealismSettings,
)
from drcli.config.groups.services import LogSettings, ProcessorSettings
from drcli.config.groups.train_settings import (
    CostSettings,
    FailureSettings,
    FigureSettings,
    InterruptionSettings,
    MessageSettings,
    TimedWorkSettings,
    TrainSettings,
    WatchSettings,
)
from drcli.config.value_types import CheckpointChoice

# What the parts of a run are told about buckets.


Cloud = Literal["local", "remote", "aws", "azure"]
Engine = Literal["rclone", "minio", "moto"]


@dataclass(frozen=True)
class StorageConfig:
    """Where the bucket is.

    Attributes:
        cloud: `local` is served by ourselves, `remote` and `azure` by an S3 address.
        data_dir: Objects of the local server are in `<data_dir>/<bucket>/`.
        port: None: the first start chooses a free one, which is kept.
        profile: Ignored for `local`. None leaves the search for keys to boto3.
    """

    cloud: Cloud
    bucket: str
    data_dir: Path
    engine: Engine = "rclone"
    port: SafeInt | None = None
    endpoint_url: str | None = None
    profile: str | None = None
    region: str = "us-east-1"
    idle_minutes: SafeInt = 10

    @property
    def at_amazon(self) -> bool:
        """Whether Amazon bills the requests."""
        host = urlsplit(self.endpoint_url or "").hostname or ""
        return self.cloud == "aws" or (self.cloud != "local" and host.endswith(".amazonaws.com"))

    @property
    def aws_profile(self) -> str | None:
        return self.profile if self.cloud == "aws" else None


@dataclass(frozen=True)
class UploadConfig:
    """The second bucket."""

    bucket: str
    profile: str | None
    endpoint_url: str
    region: str


@dataclass(frozen=True)
class TransferConfig:
    own: StorageConfig
    upload: UploadConfig


@dataclass(frozen=True)
class DroaConfig:
    """DeepRacer on AWS; texts are empty if not set."""

    url: str
    username: str
    debug: bool
    aws_endpoint_url: str


@dataclass(frozen=True)
class CustomFilesConfig:
    """The racer's three files."""

    folder: Path
    prefix: str
    reward_key: str
    hyperparameters_key: str
    metadata_key: str


@dataclass(frozen=True)
class ModelConfig:
    prefix: str
    metrics_prefix: str
    metric: str
    workers: SafeInt
    reward_key: str
    parameters_file: str


@dataclass(frozen=True)
class PretrainedConfig:
    """The model whose weights a new model begins with."""

    prefix: str
    checkpoint: CheckpointChoice
    place: Place
    checkpoint_place: Place


SUPERVISOR_ONLY = frozenset({*declared(MessageSettings), "DR_ON_END"})
"""Addresses and a command that no copy of a model tells."""


class PlacedSettings(FrozenGroups):
    """Settings with the places at which they were given."""

    directory: Path
    sources: Mapping[str, Place]
    tracks_dir: Path | None

    @property
    def tracks_folder(self) -> Path:
        return without_dots(self.directory / (self.tracks_dir or "tracks"))

    def place(self, name: str) -> Place:
        """The file is `default` where nobody gave it."""
        return self.sources.get(name, Place("default"))

    def source(self, name: str) -> str:
        """`run.env line 7`, `environment`, `flag` or `default`."""
        return str(self.place(name))


class DriveConfig(
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
            "Write DR_RACE_TYPE=HEAD_TO_BOT to train against bots, or use `dr-evaluate`.",
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

    run_id: SafeInt
    directory: Path
    logs: LogConfig
    model: ModelConfig
    storage: StorageConfig
    train: TrainConfig
    evaluation: EvaluationConfig
    unattended: UnattendedConfig
    figures: FigureConfig
    races: tuple[DriveConfig, ...]
    given: Mapping[str, str] = field(default_factory=dict)
    live_view: bool = True

    def race(self, worker: int = 0) -> DriveConfig:
        """Of a worker, counted from 0."""
        return self.races[worker if worker < len(self.races) else 0]

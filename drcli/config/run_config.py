"""The narrow values that a run is made of; each process takes those that it needs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NoReturn, Self

from drcli.base.json_record import RecordError, from_json
from drcli.base.problems import BadValue, Place, Problem
from drcli.config.fields import Setting, declared
from drcli.config.groups.opponents import BotSettings, ObstacleSettings, OpponentSettings
from drcli.config.groups.race import (
    EpisodeSettings,
    EvaluationSettings,
    RaceSettings,
    TrainSettings,
)
from drcli.config.groups.realism import RealismSettings
from drcli.config.setting_problems import setting_problem

Cloud = Literal["local", "remote", "aws", "azure"]
Engine = Literal["rclone", "minio", "moto"]


class Part:
    """Groups of settings as one frozen value, which can travel to another process as JSON."""

    declared: ClassVar[Mapping[str, Setting]]

    def __init_subclass__(cls) -> None:
        cls.declared = declared(cls)

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{type(self).__name__} is frozen; change {name} with `replaced`.")

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and vars(self) == vars(other)

    def __hash__(self) -> NoReturn:
        raise TypeError(f"{type(self).__name__} holds dictionaries and cannot be hashed.")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({vars(self)})"

    def replaced(self, **changes: Any) -> Self:
        """The same with other values for some fields."""
        return type(self)(**{**vars(self), **changes})

    def to_json(self) -> dict[str, Any]:
        """The texts that the settings files would hold, by field."""
        return {item.field: item.text(getattr(self, item.field)) for item in self.declared.values()}

    @classmethod
    def from_json(cls, value: Any) -> Self:
        """What `to_json` made, every value checked.

        Raises:
            RecordError: A setting is missing, or has a value that it cannot have.
        """
        return cls(**_read(cls, value))


class RaceConfig(
    Part, RaceSettings, EpisodeSettings, ObstacleSettings, BotSettings, RealismSettings
):
    """What one simulation worker drives: track, race, starts of episodes, sim-to-real extras.

    Attributes:
        directory: The racer's working folder, absolute.
        sources: Place at which each of these settings was given; defaults are absent.
    """

    directory: Path
    sources: Mapping[str, Place]

    @property
    def tracks_folder(self) -> Path:
        """Folder with the racer's own route files; it need not exist."""
        return self.directory / (self.tracks_dir or "tracks")

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

    def place(self, name: str) -> Place:
        """Where a DR_ setting was given; the file is `default` where nobody gave it."""
        return self.sources.get(name, Place("default"))

    def source(self, name: str) -> str:
        """The place as text: `run.env line 7`, `environment`, `flag` or `default`."""
        return str(self.place(name))

    def to_json(self) -> dict[str, Any]:
        """The texts by field, the folder and the sources."""
        folder = str(self.directory)
        return super().to_json() | {"directory": folder, "sources": dict(self.sources)}

    @classmethod
    def from_json(cls, value: Any) -> Self:
        """What `to_json` made, every value checked.

        Raises:
            RecordError: Something is missing, or has a value that it cannot have.
        """
        values, rest = _read(cls, value), from_json(_Rest, value)
        return cls(**values, directory=rest.directory, sources=rest.sources)


@dataclass(frozen=True)
class _Rest:
    """What a race is made of beside settings."""

    directory: Path
    sources: Mapping[str, Place]


class TrainConfig(Part, TrainSettings):
    """How to train: workers, goals, evaluations beside the training, the learner's processor."""


class EvaluationConfig(Part, EvaluationSettings, OpponentSettings):
    """How to evaluate, and against which model."""


@dataclass(frozen=True)
class StorageConfig:
    """Where the bucket is.

    Attributes:
        cloud: DR_CLOUD. `local` is served by ourselves, `remote` and `azure` by an S3 address,
            `aws` by Amazon.
        data_dir: Folder of the local server; objects lie under `<data_dir>/<bucket>/`.
        port: DR_LOCAL_S3_PORT. None lets the first start choose a free one, which is then kept.
        endpoint_url: DR_REMOTE_MINIO_URL, for `remote` and `azure`.
        profile: DR_LOCAL_S3_PROFILE, ignored for `local`. None leaves the search for keys to boto3.
    """

    cloud: Cloud
    bucket: str
    data_dir: Path
    engine: Engine = "rclone"
    port: int | None = None
    endpoint_url: str | None = None
    profile: str | None = None
    region: str = "us-east-1"
    idle_minutes: int = 10


@dataclass(frozen=True)
class UploadConfig:
    """The second bucket, which models are copied to and from.

    Attributes:
        endpoint_url: DR_UPLOAD_S3_ENDPOINT_URL; empty for what the profile says.
        region: DR_AWS_APP_REGION, where the profile names none.
    """

    bucket: str
    profile: str | None
    endpoint_url: str
    region: str


@dataclass(frozen=True)
class TransferConfig:
    """The two buckets between which models are copied."""

    own: StorageConfig
    upload: UploadConfig


@dataclass(frozen=True)
class CustomFilesConfig:
    """Where the racer's three files lie."""

    folder: Path
    prefix: str
    reward_key: str
    hyperparameters_key: str
    metadata_key: str


@dataclass(frozen=True)
class ModelConfig:
    """The model in the bucket."""

    prefix: str
    metrics_prefix: str
    metric: str
    workers: int
    reward_key: str
    parameters_file: str


@dataclass(frozen=True)
class PretrainedConfig:
    """The model whose weights a new model begins with.

    Attributes:
        prefix: DR_LOCAL_S3_PRETRAINED_PREFIX.
        checkpoint: DR_LOCAL_S3_PRETRAINED_CHECKPOINT.
        place: Where the prefix was given.
        checkpoint_place: Where the checkpoint was chosen.
    """

    prefix: str
    checkpoint: Literal["last", "best"]
    place: Place
    checkpoint_place: Place


@dataclass(frozen=True)
class RunConfig:
    """Everything that the processes of a training or an evaluation need to know.

    Attributes:
        races: What the first worker drives, and all others that have a race of their own.
    """

    run_id: int
    directory: Path
    log_max_mb: int
    model: ModelConfig
    storage: StorageConfig
    train: TrainConfig
    evaluation: EvaluationConfig
    races: tuple[RaceConfig, ...]

    def race(self, worker: int = 0) -> RaceConfig:
        """What a simulation worker drives, counted from 0."""
        return self.races[worker if worker < len(self.races) else 0]


def _read(part: type[Part], value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise RecordError("a group of settings is not an object with keys")
    found = {}
    for item in part.declared.values():
        field = item.field
        text = value.get(field)
        if not isinstance(text, str):
            raise RecordError(f"'{field}' is {'not a text' if field in value else 'missing'}")
        try:
            found[field] = item.read(text) if text or item.kind == "text" else item.default
        except BadValue as error:
            raise RecordError(f"'{field}' {error}") from error
    return found

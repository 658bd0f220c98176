"""All settings as one frozen object, and the narrow values that the parts of a run are given."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from drcli.base.json_record import from_json
from drcli.base.problems import Place, Problem, few
from drcli.config.bucket_config import (
    CustomFilesConfig,
    DroaConfig,
    ModelConfig,
    PretrainedConfig,
    StorageConfig,
    TransferConfig,
    UploadConfig,
)
from drcli.config.checkpoint_words import parse_checkpoint
from drcli.config.fields import FrozenGroups, Setting, declared
from drcli.config.groups.failures import FailureSettings
from drcli.config.groups.opponents import BotSettings, ObstacleSettings, OpponentSettings
from drcli.config.groups.physical_car import PhysicalCarSettings
from drcli.config.groups.processor import ProcessorSettings
from drcli.config.groups.race import (
    EpisodeSettings,
    EvaluationSettings,
    RaceSettings,
    TrainSettings,
)
from drcli.config.groups.realism import OwnCarSettings, RealismSettings
from drcli.config.groups.storage import BucketSettings, KeySettings
from drcli.config.groups.system import (
    ContainerSettings,
    DerivedSettings,
    DroaSettings,
    ScreenSettings,
    ServiceSettings,
)
from drcli.config.groups.unattended import (
    CostSettings,
    InterruptionSettings,
    MessageSettings,
    TimedWorkSettings,
    WatchSettings,
)
from drcli.config.setting_problems import hidden, setting_problem

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


@dataclass(frozen=True)
class RunConfig:
    """Everything that the processes of a training or an evaluation need to know.

    Attributes:
        races: For the first worker, and for all others that have a race of their own.
        given: The settings that somebody has given, without secrets, as texts by DR_ name: for
            commands that the run calls while the files may be edited for another training.
        eval_world_place: Where DR_TRAIN_EVAL_WORLD was given.
    """

    run_id: int
    directory: Path
    log_max_mb: int
    model: ModelConfig
    storage: StorageConfig
    train: TrainConfig
    evaluation: EvaluationConfig
    unattended: UnattendedConfig
    races: tuple[RaceConfig, ...]
    eval_world_place: Place = field(default_factory=lambda: Place("default"))
    given: Mapping[str, str] = field(default_factory=dict)

    def race(self, worker: int = 0) -> RaceConfig:
        """What a simulation worker drives, counted from 0."""
        return self.races[worker if worker < len(self.races) else 0]

    def second_race(self, race: RaceConfig) -> RaceConfig | None:
        """The same race on DR_TRAIN_EVAL_WORLD; None without that second track."""
        return on_world(race, self.train.train_eval_world, self.eval_world_place)


@dataclass(frozen=True)
class Override:
    """What the file of one worker changes: values by field, and their places by DR_ name."""

    values: Mapping[str, Any]
    sources: Mapping[str, Place]


class Settings(
    PlacedSettings,
    DerivedSettings,
    MessageSettings,
    WatchSettings,
    CostSettings,
    TimedWorkSettings,
    InterruptionSettings,
    DroaSettings,
    ServiceSettings,
    ScreenSettings,
    ContainerSettings,
    RealismSettings,
    OwnCarSettings,
    OpponentSettings,
    BotSettings,
    ObstacleSettings,
    PhysicalCarSettings,
    KeySettings,
    BucketSettings,
    EvaluationSettings,
    ProcessorSettings,
    EpisodeSettings,
    FailureSettings,
    TrainSettings,
    RaceSettings,
):
    """Every DR_ setting, checked. `load_settings` makes one; planners take narrow values from it.

    Attributes:
        extra: Names in the files that are not settings, with their values; `sources` has them too.
        problems: Warnings: what was accepted but looks odd.
        overrides: What worker-N.env changes, for the second worker first.
    """

    extra: Mapping[str, str]
    problems: tuple[Problem, ...]
    overrides: tuple[Override, ...]

    @property
    def custom_files_dir(self) -> Path:
        """Folder on this machine with the racer's own three files."""
        if not self.experiment_name:
            return self.directory / "custom_files"
        return self.directory / "experiments" / self.experiment_name / "custom_files"

    @property
    def warnings(self) -> tuple[str, ...]:
        """The problems as sentences."""
        return tuple(few(map(str, self.problems)))

    @property
    def untrainable(self) -> Problem | None:
        """Why no model can be trained with these settings; None where one can."""
        return next(filter(None, (race.untrainable for race in self.races)), None)

    def for_worker(self, worker: int) -> "Settings":
        """The settings of one simulation worker, counted from 0; the first one has these."""
        if not 1 <= worker <= len(self.overrides):
            return self
        own = self.overrides[worker - 1]
        return self.replaced(sources={**self.sources, **own.sources}, **own.values)

    @property
    def storage(self) -> StorageConfig:
        """Where the bucket is."""
        return StorageConfig(
            cloud=self.cloud,
            bucket=self.bucket,
            data_dir=self.directory / self.s3_data_dir,
            engine=self.local_s3_engine,
            port=self.local_s3_port or None,
            endpoint_url=self.remote_minio_url or None,
            profile=self.profile or None,
            region=self.aws_app_region,
            idle_minutes=self.local_s3_idle_minutes,
        )

    @property
    def transfer(self) -> TransferConfig:
        """The bucket, and the one that models are copied to and from."""
        upload = UploadConfig(
            self.upload_s3_bucket,
            self.upload_s3_profile or None,
            self.upload_s3_endpoint_url,
            self.aws_app_region,
        )
        return TransferConfig(self.storage, upload)

    @property
    def droa(self) -> DroaConfig:
        """DeepRacer on AWS."""
        return DroaConfig(
            self.droa_url, self.droa_username, self.droa_debug, self.droa_aws_endpoint_url
        )

    @property
    def custom_files(self) -> CustomFilesConfig:
        """The racer's own three files."""
        return CustomFilesConfig(
            self.custom_files_dir,
            self.custom_files_prefix,
            self.reward_key,
            self.hyperparameters_key,
            self.model_metadata_key,
        )

    @property
    def model(self) -> ModelConfig:
        """The model to train or evaluate."""
        return ModelConfig(
            prefix=self.model_prefix,
            metrics_prefix=self.metrics_prefix,
            metric=self.train_best_model_metric,
            workers=self.workers,
            reward_key=self.reward_key,
            parameters_file=self.training_params_file,
        )

    @property
    def pretrained_model(self) -> PretrainedConfig | None:
        """The model whose weights a new model begins with; None for fresh weights."""
        if not self.pretrained:
            return None
        return PretrainedConfig(
            self.pretrained_prefix,
            parse_checkpoint(self.pretrained_checkpoint),
            self.place("DR_LOCAL_S3_PRETRAINED_PREFIX"),
            self.place("DR_LOCAL_S3_PRETRAINED_CHECKPOINT"),
        )

    @property
    def race(self) -> RaceConfig:
        """What the first simulation worker drives."""
        return RaceConfig(
            **self._of(RaceConfig),
            directory=self.directory,
            sources={n: place for n, place in self.sources.items() if n in RaceConfig.declared},
        )

    @property
    def races(self) -> tuple[RaceConfig, ...]:
        """What the first worker drives, and all others that have a file of their own."""
        return tuple(self.for_worker(k).race for k in range(len(self.overrides) + 1))

    @property
    def run(self) -> RunConfig:
        """What the processes of a training or an evaluation need to know."""
        return RunConfig(
            run_id=self.run_id,
            directory=self.directory,
            log_max_mb=self.log_max_mb,
            model=self.model,
            storage=self.storage,
            train=TrainConfig(**self._of(TrainConfig)),
            evaluation=EvaluationConfig(**self._of(EvaluationConfig)),
            unattended=UnattendedConfig(**self._of(UnattendedConfig)),
            races=self.races,
            eval_world_place=self.place("DR_TRAIN_EVAL_WORLD"),
            given=self._given(),
        )

    def _given(self) -> dict[str, str]:
        """Texts of the settings that somebody has given, except the secret ones."""
        texts = {
            name: setting.text(getattr(self, setting.field))
            for name, setting in catalogue().items()
            if name in self.sources and setting.effect == "used" and name not in SUPERVISOR_ONLY
        }
        return {name: text for name, text in texts.items() if hidden(name, text) == text}

    def _of(self, part: type[FrozenGroups]) -> dict[str, Any]:
        """The values of the groups that a narrow value has."""
        return {item.field: getattr(self, item.field) for item in part.declared.values()}


def on_world(race: RaceConfig, world: str, place: Place) -> RaceConfig | None:
    """A race on another track, whose name was given at that place; None without a name."""
    if not world:
        return None
    return race.replaced(world_name=world, sources={**race.sources, "DR_WORLD_NAME": place})


def catalogue() -> Mapping[str, Setting]:
    """Every setting by its DR_ name, in the order of the documentation."""
    return Settings.declared

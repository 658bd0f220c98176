"""All settings as one frozen object, from which narrow values are taken."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from drcli.base.problems import Place, Problem, few
from drcli.config.fields import Setting
from drcli.config.groups.opponents import BotSettings, ObstacleSettings, OpponentSettings
from drcli.config.groups.race import (
    EpisodeSettings,
    EvaluationSettings,
    RaceSettings,
    TrainSettings,
)
from drcli.config.groups.realism import RealismSettings
from drcli.config.groups.storage import BucketSettings, KeySettings
from drcli.config.groups.system import (
    ContainerSettings,
    DerivedSettings,
    ScreenSettings,
    ServiceSettings,
)
from drcli.config.run_config import (
    CustomFilesConfig,
    EvaluationConfig,
    ModelConfig,
    Part,
    PretrainedConfig,
    RaceConfig,
    RunConfig,
    StorageConfig,
    TrainConfig,
    TransferConfig,
    UploadConfig,
)


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
    Part,
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
    EpisodeSettings,
    TrainSettings,
    RaceSettings,
):
    """Every DR_ setting, checked. `load_settings` makes one; planners take narrow values from it.

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
        super().__init__(
            **fields | values,
            directory=directory,
            extra=extra,
            sources=sources,
            problems=problems,
            overrides=overrides,
        )

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
        return next(filter(None, (race.untrainable for race in self.races)), None)

    def for_worker(self, worker: int) -> "Settings":
        """The settings of one simulation worker, counted from 0; the first one has these."""
        if not 1 <= worker <= len(self.overrides):
            return self
        own = self.overrides[worker - 1]
        return self.replaced(sources={**self.sources, **own.sources}, **typed(own.values))

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
            self.pretrained_checkpoint,
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
            races=self.races,
        )

    def _of(self, part: type[Part]) -> dict[str, Any]:
        """The values of the groups that a narrow value has."""
        return {item.field: getattr(self, item.field) for item in part.declared.values()}


def catalogue() -> Mapping[str, Setting]:
    """What is known about every setting, by DR_ name, in the order of the documentation."""
    return Settings.declared


def typed(texts: Mapping[str, str]) -> dict[str, Any]:
    """Values by field, for texts by field.

    Raises:
        BadValue: A text does not fit its setting.
    """
    by_field = {setting.field: setting for setting in catalogue().values()}
    return {field: by_field[field].read(text) for field, text in texts.items()}

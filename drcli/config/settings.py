"""All settings as one frozen object, from which planners take narrow values."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drcli.base.errors import Place, Problem, few
from drcli.base.files import without_dots
from drcli.config.fields import FrozenGroups, Setting, hidden
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
from drcli.config.groups.services import (
    BucketSettings,
    KeySettings,
    LiveSettings,
    LogSettings,
    PhysicalCarSettings,
    ProcessorSettings,
    WebSettings,
)
from drcli.config.groups.system import (
    ContainerSettings,
    DerivedSettings,
    DroaSettings,
    ScreenSettings,
    ServiceSettings,
)
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
from drcli.config.run_config import (
    SUPERVISOR_ONLY,
    CustomFilesConfig,
    DriveConfig,
    DroaConfig,
    EvaluationConfig,
    FigureConfig,
    LogConfig,
    ModelConfig,
    PlacedSettings,
    PretrainedConfig,
    RunConfig,
    StorageConfig,
    TrainConfig,
    TransferConfig,
    UnattendedConfig,
    UploadConfig,
    WebConfig,
)
from drcli.config.value_types import parse_checkpoint


@dataclass(frozen=True)
class Override:
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
    FigureSettings,
    WebSettings,
    LiveSettings,
    ScreenSettings,
    ContainerSettings,
    LogSettings,
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
    """Every DR_ setting, checked.

    Attributes:
        extra: Other names in the files.
        written: Texts of run.env, with `$NAME`.
        problems: Warnings.
        overrides: What worker-N.env changes, from the second worker on.
    """

    extra: Mapping[str, str]
    written: Mapping[str, str]
    problems: tuple[Problem, ...]
    overrides: tuple[Override, ...]

    @property
    def custom_files_dir(self) -> Path:
        if not self.experiment_name:
            return self.directory / "custom_files"
        return self.directory / "experiments" / self.experiment_name / "custom_files"

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(few(map(str, self.problems)))

    @property
    def untrainable(self) -> Problem | None:
        """Why no model can be trained with these settings."""
        return next(filter(None, (race.untrainable for race in self.races)), None)

    def for_worker(self, worker: int) -> "Settings":
        """Counted from 0; the first one has these."""
        if not 1 <= worker <= len(self.overrides):
            return self
        own = self.overrides[worker - 1]
        return self.replaced(sources={**self.sources, **own.sources}, **own.values)

    @property
    def storage(self) -> StorageConfig:
        return StorageConfig(
            cloud=self.cloud,
            bucket=self.bucket,
            data_dir=without_dots(self.directory / self.s3_data_dir),
            engine=self.local_s3_engine,
            port=self.local_s3_port or None,
            endpoint_url=self.remote_minio_url or None,
            profile=self.profile or None,
            region=self.aws_app_region,
            idle_minutes=self.local_s3_idle_minutes,
        )

    @property
    def transfer(self) -> TransferConfig:
        upload = UploadConfig(
            self.upload_s3_bucket,
            self.upload_s3_profile or None,
            self.upload_s3_endpoint_url,
            self.aws_app_region,
        )
        return TransferConfig(self.storage, upload)

    @property
    def droa(self) -> DroaConfig:
        return DroaConfig(
            self.droa_url, self.droa_username, self.droa_debug, self.droa_aws_endpoint_url
        )

    @property
    def web(self) -> WebConfig:
        return WebConfig(
            self.webviewer_host,
            self.webviewer_port,
            self.place("DR_WEBVIEWER_PORT"),
            self.webviewer_auth == "token",
        )

    @property
    def custom_files(self) -> CustomFilesConfig:
        return CustomFilesConfig(
            self.custom_files_dir,
            self.custom_files_prefix,
            self.reward_key,
            self.hyperparameters_key,
            self.model_metadata_key,
        )

    @property
    def model(self) -> ModelConfig:
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
        """None for fresh weights."""
        if not self.pretrained:
            return None
        return PretrainedConfig(
            self.pretrained_prefix,
            parse_checkpoint(self.pretrained_checkpoint),
            self.place("DR_LOCAL_S3_PRETRAINED_PREFIX"),
            self.place("DR_LOCAL_S3_PRETRAINED_CHECKPOINT"),
        )

    @property
    def race(self) -> DriveConfig:
        return DriveConfig(
            **self._of(DriveConfig),
            directory=self.directory,
            sources={n: place for n, place in self.sources.items() if n in DriveConfig.declared},
        )

    @property
    def races(self) -> tuple[DriveConfig, ...]:
        """Of the first worker, and of others with a file of their own."""
        return tuple(self.for_worker(k).race for k in range(len(self.overrides) + 1))

    @property
    def run(self) -> RunConfig:
        return RunConfig(
            run_id=self.run_id,
            directory=self.directory,
            logs=LogConfig(**self._of(LogConfig)),
            model=self.model,
            storage=self.storage,
            train=TrainConfig(**self._of(TrainConfig)),
            evaluation=EvaluationConfig(**self._of(EvaluationConfig)),
            unattended=UnattendedConfig(**self._of(UnattendedConfig)),
            figures=FigureConfig(**self._of(FigureConfig)),
            races=self.races,
            given=self._given(),
            live_view=self.live_view,
        )

    def _given(self) -> dict[str, str]:
        texts = {
            name: setting.text(getattr(self, setting.field))
            for name, setting in catalogue().items()
            if name in self.sources and setting.effect == "used" and name not in SUPERVISOR_ONLY
        }
        return {name: text for name, text in texts.items() if hidden(name, text) == text}

    def _of(self, part: type[FrozenGroups]) -> dict[str, Any]:
        return {item.field: getattr(self, item.field) for item in part.declared.values()}


def catalogue() -> Mapping[str, Setting]:
    """Every setting, in the order of the documentation."""
    return Settings.declared

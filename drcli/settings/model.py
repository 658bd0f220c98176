"""All settings as one frozen object that can travel to another process."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Literal

from drcli.settings.fields import Setting, declared
from drcli.settings.racing import EvaluationSettings, RaceSettings, TrainSettings
from drcli.settings.realism import RealismSettings
from drcli.settings.rivals import BotSettings, ObstacleSettings, OpponentSettings
from drcli.settings.storage import BucketSettings, KeySettings
from drcli.settings.system import (
    ContainerSettings,
    DerivedSettings,
    ScreenSettings,
    ServiceSettings,
)


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
        extra: Names in the files that are no settings, with their values.
        sources: Place at which each setting was given, by DR_ name; defaults are absent.
        warnings: Sentences about what was accepted but looks odd.
    """

    directory: Path
    extra: Mapping[str, str]
    sources: Mapping[str, str]
    warnings: tuple[str, ...]

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

    def source(self, name: str) -> str:
        """Where a DR_ setting was given: `run.env line 7`, `environment`, `flag` or `default`."""
        return self.sources.get(name, "default")

    def unsupported(self, job: Literal["training", "evaluation"] = "training") -> str | None:
        """Why these settings cannot be run, as one sentence; None when they can."""
        if self.race_type == "HEAD_TO_MODEL" and job == "training":
            return (
                f"{self.source('DR_RACE_TYPE')}: DR_RACE_TYPE=HEAD_TO_MODEL races two finished "
                "models and is there for evaluations only, no model can be trained in it."
            )
        if self.pretrained and job == "training":
            return (
                f"{self.source('DR_LOCAL_S3_PRETRAINED')}: DR_LOCAL_S3_PRETRAINED=True cannot be "
                "done yet, a training starts with fresh weights."
            )
        return None

    def dump(self) -> str:
        """All of it as JSON text for `restore`."""
        return self.model_dump_json()

    @staticmethod
    def restore(text: str) -> "Settings":
        """The settings that `dump` wrote down, in this or another process."""
        return Settings.model_validate_json(text)


@cache
def catalogue() -> Mapping[str, Setting]:
    """What is known about every setting, by DR_ name, in the order of the documentation."""
    return declared(Settings)

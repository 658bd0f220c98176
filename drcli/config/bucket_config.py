"""What the parts of a run are told about buckets."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from drcli.base.problems import Place
from drcli.config.checkpoint_words import CheckpointChoice

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
    port: int | None = None
    endpoint_url: str | None = None
    profile: str | None = None
    region: str = "us-east-1"
    idle_minutes: int = 10

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
    workers: int
    reward_key: str
    parameters_file: str


@dataclass(frozen=True)
class PretrainedConfig:
    """The model whose weights a new model begins with."""

    prefix: str
    checkpoint: CheckpointChoice
    place: Place
    checkpoint_place: Place

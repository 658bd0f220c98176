"""What the parts of a run are told about buckets, models in them, and files to copy there."""

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
        cloud: DR_CLOUD. `local` is served by ourselves, `remote` and `azure` by an S3 address,
            `aws` by Amazon.
        data_dir: Folder of the local server; objects are in `<data_dir>/<bucket>/`.
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

    @property
    def at_amazon(self) -> bool:
        """Whether Amazon bills the requests; what another server costs is not known."""
        host = urlsplit(self.endpoint_url or "").hostname or ""
        return self.cloud == "aws" or (self.cloud != "local" and host.endswith(".amazonaws.com"))

    @property
    def aws_profile(self) -> str | None:
        """The profile for other services of Amazon; None if the bucket is not there."""
        return self.profile if self.cloud == "aws" else None


@dataclass(frozen=True)
class UploadConfig:
    """The second bucket, which models are copied to and from.

    Attributes:
        endpoint_url: DR_UPLOAD_S3_ENDPOINT_URL; empty to use that of the profile.
        region: DR_AWS_APP_REGION, for a profile without a region.
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
class DroaConfig:
    """DeepRacer on AWS.

    Attributes:
        url: DR_DROA_URL, the address of its web page; empty if not set.
        username: DR_DROA_USERNAME; empty if not set.
        debug: DR_DROA_DEBUG.
        aws_endpoint_url: DR_DROA_AWS_ENDPOINT_URL; empty for Amazon's own addresses.
    """

    url: str
    username: str
    debug: bool
    aws_endpoint_url: str


@dataclass(frozen=True)
class CustomFilesConfig:
    """Where the racer's three files are: a folder on this machine, and places in the bucket."""

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
    """The model whose weights a new model begins with, and where its two settings were given."""

    prefix: str
    checkpoint: CheckpointChoice
    place: Place
    checkpoint_place: Place

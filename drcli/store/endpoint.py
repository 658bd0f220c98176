"""The address of an S3 server with the access keys, and the settings that it came from."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.config.settings import Engine


@dataclass(frozen=True)
class SettingNames:
    """What the settings are called that led to a bucket, for the words of an error.

    Args:
        bucket: Decides the bucket.
        prefix: Decides the model in it.
        profile: Decides the access keys.
        address: Decides the server where it is not Amazon's.
        amazon: Decides that it is Amazon's.
    """

    bucket: str = "DR_LOCAL_S3_BUCKET"
    prefix: str = "DR_LOCAL_S3_MODEL_PREFIX"
    profile: str = "DR_LOCAL_S3_PROFILE"
    address: str = "DR_REMOTE_MINIO_URL"
    amazon: str = "DR_CLOUD=aws"


UPLOADS = SettingNames(
    bucket="DR_UPLOAD_S3_BUCKET",
    prefix="DR_UPLOAD_S3_PREFIX",
    profile="DR_UPLOAD_S3_PROFILE",
    address="DR_UPLOAD_S3_ENDPOINT_URL",
    amazon="DR_UPLOAD_S3_PROFILE",
)
"""Those of the bucket that models are copied to."""


@dataclass(frozen=True)
class Endpoint:
    """An S3 address together with what is needed to sign requests to it.

    Args:
        url: Address, None for Amazon's own.
        access_key: None when boto3 looks for keys itself (profile, environment, instance role).
        secret_key: Belongs to `access_key`; never printed.
        profile: Profile of the AWS files to take the keys from.
        region: Region to sign for.
        engine: Program behind a local address, None for anybody else's server.
        pid: Process of the local server where it is known.
        data_dir: Folder in which the local server keeps its objects.
        names: What the settings behind all this are called.
    """

    url: str | None
    access_key: str | None = None
    secret_key: str | None = field(default=None, repr=False)
    profile: str | None = None
    region: str = "us-east-1"
    engine: Engine | None = None
    pid: int | None = None
    data_dir: Path | None = None
    names: SettingNames = SettingNames()

    @property
    def setting(self) -> str:
        """Name of the setting that decides where this address points."""
        if self.engine is not None:
            return "DR_CLOUD=local"
        return self.names.amazon if self.url is None else self.names.address

    @property
    def place(self) -> str:
        """The address as it reads in a sentence: without a password that stands in it."""
        if self.url is None:
            return f"Amazon S3 ({self.region})"
        scheme, colon, rest = self.url.partition("://")
        return scheme + colon + rest.rpartition("@")[2]

"""The address of an S3 server with the access keys, and the settings that it came from."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.config.bucket_config import Engine


@dataclass(frozen=True)
class SettingNames:
    """Names of the settings of a bucket, for errors; `amazon` selects Amazon's server."""

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
"""Of the bucket that models are copied to."""


@dataclass(frozen=True)
class Endpoint:
    """The address of an S3 server, and the keys for it.

    Args:
        url: None for Amazon's server.
        access_key: None if boto3 finds the keys (profile, environment, instance role).
        secret_key: Never printed.
        profile: In the AWS files.
        region: Region to sign for.
        engine: Program of the local server, None for another server.
        pid: Process of the local server, if known.
        data_dir: Folder of the local server.
        names: Of the settings.
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
        """Name of the setting that selects this server."""
        if self.engine is not None:
            return "DR_CLOUD=local"
        return self.names.amazon if self.url is None else self.names.address

    @property
    def place(self) -> str:
        """The address for a sentence, without a password."""
        if self.url is None:
            return f"Amazon S3 ({self.region})"
        scheme, colon, rest = self.url.partition("://")
        return scheme + colon + rest.rpartition("@")[2]

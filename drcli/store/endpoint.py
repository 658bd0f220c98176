"""The address of an S3 server, with keys and their settings."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.config.bucket_config import Engine


@dataclass(frozen=True)
class SettingNames:
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


@dataclass(frozen=True)
class Endpoint:
    """The address of an S3 server, and its keys.

    Args:
        url: None for Amazon's.
        access_key: None if boto3 finds the keys.
        secret_key: Never printed.
        profile: In the AWS files.
        region: To sign for.
        engine: Of a local server, as the next two.
        pid: If known.
        data_dir: Its folder.
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
        if self.engine is not None:
            return "DR_CLOUD=local"
        return self.names.amazon if self.url is None else self.names.address

    @property
    def place(self) -> str:
        """For a sentence, without a password."""
        if self.url is None:
            return f"Amazon S3 ({self.region})"
        scheme, colon, rest = self.url.partition("://")
        return scheme + colon + rest.rpartition("@")[2]

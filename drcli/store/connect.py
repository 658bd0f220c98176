"""Opens the bucket of a run, for writers or readers, and that for uploads."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

from drcli.config.bucket_config import StorageConfig, UploadConfig
from drcli.store.bucket import Bucket
from drcli.store.endpoint import UPLOADS, Endpoint, SettingNames
from drcli.store.folder_bucket import FolderBucket
from drcli.store.profiles import read_profile
from drcli.store.s3_bucket import S3Bucket
from drcli.store.server import server

COMMAND_PATIENCE_S = 5.0
OUTAGE_PATIENCE_S = 900.0
"""Of what nobody watches: outages of minutes cost no more than their duration."""

_READ_TIMEOUT_S, _LOCAL_READ_TIMEOUT_S = 60.0, 30.0
"""How long an answer may stall before the request is repeated. The local server has no network."""

_LOOK_TIMEOUT_S = 2.0


def open_bucket(
    config: StorageConfig,
    *,
    patience_s: float = 60.0,
    read_timeout_s: float | None = None,
    hurried: Callable[[], bool] = lambda: False,
    unattended: bool = False,
) -> S3Bucket:
    """The bucket, whose local server is started if needed; options as of `S3Bucket`.

    Raises:
        StorageError: The server cannot be started or found.
    """
    usual_s = _LOCAL_READ_TIMEOUT_S if config.cloud == "local" else _READ_TIMEOUT_S
    return S3Bucket(
        server.ensure_running(config),
        config.bucket,
        patience_s=patience_s,
        read_timeout_s=read_timeout_s or usual_s,
        hurried=hurried,
        unattended=unattended,
    )


def open_running_bucket(config: StorageConfig) -> Bucket | None:
    """The bucket for readers, which starts no server.

    rclone's objects are plain files, read directly; None if another local server does not run.
    """
    if config.cloud == "local" and config.engine == "rclone":
        folder = config.data_dir / config.bucket
        return FolderBucket(folder) if folder.is_dir() else None
    endpoint = server.find_running(config)
    return None if endpoint is None else _impatient(endpoint, config.bucket)


def open_upload_bucket(
    config: UploadConfig,
    *,
    name: str | None = None,
    names: SettingNames = UPLOADS,
    patience_s: float = 60.0,
) -> S3Bucket:
    """A bucket on the server for uploads.

    That is DR_UPLOAD_S3_ENDPOINT_URL, else DR_UPLOAD_S3_PROFILE's in the AWS files, else Amazon's.

    Raises:
        StorageError: The profile does not exist.
    """
    found = read_profile(config.profile, names.profile)
    if not config.endpoint_url:
        names = replace(names, address=names.profile)
    endpoint = Endpoint(
        config.endpoint_url or found.endpoint_url,
        profile=config.profile,
        region=found.region or config.region,
        names=names,
    )
    return S3Bucket(endpoint, name or config.bucket, patience_s=patience_s)


@lru_cache(maxsize=4)
def _impatient(endpoint: Endpoint, name: str) -> Bucket:
    return S3Bucket(endpoint, name, patience_s=2.0, read_timeout_s=_LOOK_TIMEOUT_S)

"""Opens the bucket of a run, the one to look at, and the one that models are copied to."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

from drcli.config.settings import StorageConfig, UploadConfig
from drcli.store.bucket import Bucket
from drcli.store.endpoint import UPLOADS, Endpoint, SettingNames
from drcli.store.folder_bucket import FolderBucket
from drcli.store.profiles import read_profile
from drcli.store.s3_bucket import S3Bucket
from drcli.store.server import server

_READ_TIMEOUT_S, _LOCAL_READ_TIMEOUT_S = 60.0, 30.0
"""How long an answer may stall before it is asked for again. No network holds up the local one."""

_LOOK_TIMEOUT_S = 2.0
"""How long it may stall for readers, who also read once more when they were told to stop."""


def open_bucket(
    config: StorageConfig,
    *,
    patience_s: float = 60.0,
    read_timeout_s: float | None = None,
    hurried: Callable[[], bool] = lambda: False,
) -> S3Bucket:
    """The bucket, its local server started where needed.

    Args:
        config: Where it is.
        patience_s: How long calls wait for a server that does not answer: a worker lets its
            supervisor bring the server back, a command's user wants to know soon.
        read_timeout_s: For how long an answer may stall; as befits the server if left out.
        hurried: Whether this process was asked to stop; then calls wait no longer.

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
    )


def open_running_bucket(config: StorageConfig) -> Bucket | None:
    """The bucket for readers, which starts no server.

    Objects that the local server keeps as files are read directly, whether it runs or not.

    Returns:
        None where a local server that keeps them in another way does not run.
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
    """A bucket on the server that models are copied to and from.

    That server is DR_UPLOAD_S3_ENDPOINT_URL; where it is not set, what DR_UPLOAD_S3_PROFILE says
    in the AWS files; else Amazon's.

    Args:
        config: Where it is.
        name: Another bucket there than DR_UPLOAD_S3_BUCKET.
        names: What to call the settings in errors.
        patience_s: How long calls wait for a server that does not answer.

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
    """A cached client, because making one takes longer than reading an object."""
    return S3Bucket(endpoint, name, patience_s=2.0, read_timeout_s=_LOOK_TIMEOUT_S)

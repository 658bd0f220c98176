"""From settings to the bucket for those who only look; loads little, because they look often."""

from functools import lru_cache
from pathlib import Path

from drcli.config.settings import Settings
from drcli.store.bucket import Bucket
from drcli.store.endpoint import Endpoint, StorageConfig
from drcli.store.folder_bucket import FolderBucket

READ_TIMEOUT_S = 2.0
"""How long an answer may stall for those who only look. A command that was told to end looks once
more at the very end."""


def storage_config(settings: Settings, directory: Path) -> StorageConfig:
    """Where the bucket is, relative to the racer's working folder."""
    return StorageConfig(
        cloud=settings.cloud,
        bucket=settings.bucket,
        data_dir=directory / settings.s3_data_dir,
        engine=settings.local_s3_engine,
        port=settings.local_s3_port or None,
        endpoint_url=settings.remote_minio_url or None,
        profile=settings.profile or None,
        region=settings.aws_app_region,
        idle_minutes=settings.local_s3_idle_minutes,
    )


def open_running_bucket(settings: Settings, directory: Path) -> Bucket | None:
    """The bucket to look at, never to write to; starts nothing.

    Objects that the local server keeps as files are read without it, whether it runs or not.

    Returns:
        None where a local server that keeps them in another way does not run.
    """
    config = storage_config(settings, directory)
    if config.cloud == "local" and config.engine == "rclone":
        folder = config.data_dir / config.bucket
        return FolderBucket(folder) if folder.is_dir() else None
    from drcli.store.server.server import find_running

    endpoint = find_running(config)
    if endpoint is None:
        return None
    return _impatient(endpoint, settings.bucket)


@lru_cache(maxsize=4)
def _impatient(endpoint: Endpoint, name: str) -> Bucket:
    """A bucket for those who look again and again: making a client takes longer than a look."""
    from drcli.store.s3_bucket import S3Bucket

    return S3Bucket(endpoint, name, patience_s=2.0, read_timeout_s=READ_TIMEOUT_S)

"""From settings to the bucket they mean."""

from functools import lru_cache
from pathlib import Path

from drcli.config import Settings
from drcli.store.endpoint import Endpoint, StorageConfig
from drcli.store.s3 import S3Bucket
from drcli.store.server import connect, ensure_running, find_running, stop


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
    )


def open_bucket(settings: Settings, directory: Path, *, patience_s: float = 60.0) -> S3Bucket:
    """The bucket, its local server started where needed.

    Args:
        settings: Say where it is.
        directory: The racer's working folder.
        patience_s: How long calls wait for a server that does not answer: a worker lets its
            supervisor bring the server back, a command's user wants to know soon.

    Raises:
        StorageError: The server cannot be started or found.
    """
    return connect(storage_config(settings, directory), patience_s=patience_s)


def open_running_bucket(settings: Settings, directory: Path) -> S3Bucket | None:
    """The bucket, or None where its local server does not run; starts nothing."""
    endpoint = find_running(storage_config(settings, directory))
    if endpoint is None:
        return None
    return _impatient(endpoint, settings.bucket)


def ensure_storage(settings: Settings, directory: Path) -> None:
    """Start the local server where it does not answer; a supervisor calls this every second."""
    ensure_running(storage_config(settings, directory))


def stop_storage(settings: Settings, directory: Path) -> bool:
    """End the local server; objects stay. True when one was running."""
    return stop(storage_config(settings, directory))


@lru_cache(maxsize=4)
def _impatient(endpoint: Endpoint, name: str) -> S3Bucket:
    """A bucket for those who look again and again: making a client takes longer than a look."""
    return S3Bucket(endpoint, name, patience_s=2.0)

"""From settings to the bucket they mean."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drcli.config.settings import Settings, catalogue
from drcli.store.endpoint import UPLOADS, Endpoint, SettingNames, StorageConfig
from drcli.store.open_running import storage_config
from drcli.store.profiles import read_profile
from drcli.store.s3_bucket import S3Bucket
from drcli.store.server.server import connect, ensure_running, last_known, restart, stop


def open_bucket(
    settings: Settings,
    directory: Path,
    *,
    patience_s: float = 60.0,
    read_timeout_s: float | None = None,
    hurried: Callable[[], bool] = lambda: False,
) -> S3Bucket:
    """The bucket, its local server started where needed.

    Args:
        settings: Say where it is.
        directory: The racer's working folder.
        patience_s: How long calls wait for a server that does not answer: a worker lets its
            supervisor bring the server back, a command's user wants to know soon.
        read_timeout_s: For how long an answer may stall; as befits the server if left out.
        hurried: Whether this process was asked to leave, which ends its patience.

    Raises:
        StorageError: The server cannot be started or found.
    """
    return connect(
        storage_config(settings, directory),
        patience_s=patience_s,
        read_timeout_s=read_timeout_s,
        hurried=hurried,
    )


def open_upload_bucket(
    settings: Settings,
    *,
    name: str | None = None,
    names: SettingNames = UPLOADS,
    patience_s: float = 60.0,
) -> S3Bucket:
    """A bucket on the server that models are copied to and from.

    That server is DR_UPLOAD_S3_ENDPOINT_URL; where it is not set, what DR_UPLOAD_S3_PROFILE says
    in the AWS files; else Amazon's.

    Args:
        settings: Say where it is.
        name: Another bucket there than DR_UPLOAD_S3_BUCKET.
        names: What to call the settings in errors.
        patience_s: How long calls wait for a server that does not answer.

    Raises:
        StorageError: The profile does not exist.
    """
    profile = settings.upload_s3_profile or None
    found = read_profile(profile, names.profile)
    if not settings.upload_s3_endpoint_url:
        names = replace(names, address=names.profile)
    endpoint = Endpoint(
        settings.upload_s3_endpoint_url or found.endpoint_url,
        profile=profile,
        region=found.region or settings.aws_app_region,
        names=names,
    )
    return S3Bucket(endpoint, name or settings.upload_s3_bucket, patience_s=patience_s)


def known_endpoint(settings: Settings, directory: Path) -> Endpoint | None:
    """The bucket's server, None where the local one was never started; starts and asks nobody.

    The `pid` of a local server that does not run is None.
    """
    return last_known(storage_config(settings, directory))


def running_endpoint(settings: Settings, directory: Path) -> Endpoint:
    """The bucket's server, the local one started where needed; for other programs to talk to."""
    return ensure_running(storage_config(settings, directory))


def ensure_storage(settings: Settings, directory: Path) -> None:
    """Start the local server where it does not answer; a supervisor calls this every second."""
    ensure_running(storage_config(settings, directory))


def restart_storage(settings: Settings, directory: Path) -> None:
    """Start the local server anew, whatever it says; objects stay."""
    restart(storage_config(settings, directory))


def stop_storage(settings: Settings, directory: Path) -> bool:
    """End the local server; objects stay. True when one was running."""
    return stop(storage_config(settings, directory))


def stop_default_storage(directory: Path) -> bool:
    """The same where the settings cannot be read: for the server whose objects lie in data/s3."""
    folder = directory / catalogue()["DR_S3_DATA_DIR"].default
    return stop(StorageConfig("local", "", folder))

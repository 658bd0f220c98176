"""Opens the bucket of a run, for writers or readers, and that for uploads."""

import os
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime
from fnmatch import fnmatch
from functools import lru_cache
from pathlib import Path
from typing import NoReturn

from drcli.base.errors import StorageError
from drcli.bucket.bucket import (
    Bucket,
    Listing,
    ObjectInfo,
    ObjectMissing,
    Watch,
    checked_folder,
    without_placeholders,
)
from drcli.bucket.endpoint import UPLOADS, Endpoint, SettingNames, read_profile
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.bucket.server.server_process import LEFTOVERS
from drcli.config.run_config import StorageConfig, UploadConfig

# Reads the embedded server's bucket directly, as its objects are plain files.
#
# An S3 client takes half a second to create. Only the server writes: it would notice other
# changes late.


class FolderBucket:
    """Raises TypeError on writing."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.name = folder.name

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        path = self._folder / key
        try:
            data = path.read_bytes()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as e:
            raise ObjectMissing(
                f"The object {self.name}/{key} does not exist in {self._folder.parent}.",
                remedy="Check the name, and DR_LOCAL_S3_MODEL_PREFIX.",
            ) from e
        except OSError as e:
            raise self._unreadable(path, e) from e
        if watch is not None:
            watch(len(data))
        return data

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        data = self.get(key)
        try:
            modified_s = (self._folder / key).stat().st_mtime
        except OSError:  # deleted in the meantime
            return data, None
        return data, time.time() - modified_s

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> NoReturn:
        raise self._read_only()

    def delete(self, keys: Iterable[str]) -> NoReturn:
        raise self._read_only()

    def exists(self, key: str) -> bool:
        return (self._folder / key).is_file()

    def list(self, folder: str) -> Listing:
        top = self._folder / checked_folder(folder)
        found = []
        for place, _, names in os.walk(top):
            for name in names:
                path = Path(place, name)
                if not fnmatch(name, LEFTOVERS):
                    found += self._info(path)
        return without_placeholders(found)

    def _info(self, path: Path) -> Listing:
        try:
            facts = path.stat()
        except FileNotFoundError:  # deleted in the meantime
            return []
        except OSError as e:
            raise self._unreadable(path, e) from e
        key = path.relative_to(self._folder).as_posix()
        modified = datetime.fromtimestamp(facts.st_mtime, UTC)
        return [ObjectInfo(key, facts.st_size, "", modified)]

    def _unreadable(self, path: Path, error: OSError) -> StorageError:
        return StorageError(
            f"Cannot read {path}: {error.strerror or error} (DR_S3_DATA_DIR).",
            remedy="Check that you can read that file and its folders.",
        )

    def _read_only(self) -> TypeError:
        return TypeError(f"The bucket in {self._folder} is read-only; write through its server.")


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

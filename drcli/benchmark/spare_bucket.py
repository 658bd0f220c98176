"""The bucket that `dr bench` measures."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from drcli.base.errors import StorageError
from drcli.config.bucket_config import StorageConfig
from drcli.config.settings import Settings
from drcli.store.bucket import Bucket
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.server import server

_FOLDER = ".dr-bench-"


@contextmanager
def bucket_to_measure(settings: Settings, *, temporary: bool) -> Iterator[tuple[str, Bucket]]:
    """Name and bucket; on this machine a spare server with files on the same disk."""
    storage = settings.storage
    if storage.cloud != "local":
        bucket = open_bucket(storage, patience_s=COMMAND_PATIENCE_S)
        where = storage.endpoint_url or "Amazon S3"
        yield f"{storage.cloud}: s3://{storage.bucket} at {where}", bucket
        return
    above = Path(tempfile.gettempdir())
    if not temporary:
        near = next(p for p in (storage.data_dir, *storage.data_dir.parents) if p.is_dir())
        above = near if os.access(near, os.W_OK | os.X_OK) else above
    sweep(above)
    folder = above / f"{_FOLDER}{os.getpid()}"
    own = StorageConfig("local", "bench", folder, storage.engine, region=storage.region)
    try:
        yield f"local: {storage.engine}, files in {above}", open_bucket(own)
    finally:
        with suppress(StorageError):
            server.stop(own)
        shutil.rmtree(folder, ignore_errors=True)


def sweep(above: Path) -> None:
    """Remove what killed measurements left."""
    for folder in above.glob(f"{_FOLDER}*"):
        number = folder.name.removeprefix(_FOLDER)
        if number.isdigit() and not psutil.pid_exists(int(number)):
            with suppress(StorageError):
                server.stop(StorageConfig("local", "bench", folder))
            shutil.rmtree(folder, ignore_errors=True)

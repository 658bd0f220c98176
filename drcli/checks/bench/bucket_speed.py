"""Measures a bucket with little traffic, without traces."""

import os
import shutil
import statistics
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import psutil

from drcli.base.errors import StorageError
from drcli.bucket.bucket import TEST_FOLDER, Bucket
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.bucket.server import server
from drcli.config.run_config import StorageConfig
from drcli.config.settings import Settings

SMALL_BYTES = 1024
"""As a pointer, record or lease."""

LARGE_BYTES = (1 << 18, 1 << 20, 1 << 22)
"""Tried in order; a slow network ends with the first."""

MOST_REQUESTS = 120
MOST_BYTES = 32 << 20
"""In each direction, as remote traffic costs."""

_LEFTOVER_AGE = timedelta(hours=1)

_SHORTEST_S = 1e-6


@dataclass(frozen=True)
class BucketSpeed:
    """How fast a bucket is."""

    put_mb_per_s: Annotated[float, "Written, millions of bytes per second."]
    get_mb_per_s: Annotated[float, "Read."]
    requests_per_s: Annotated[float, "Small objects written and read one after the other."]
    request_ms: Annotated[float, "Median time of one of them, milliseconds."]
    requests: Annotated[int, "All that were sent."]
    sent_bytes: Annotated[int, "Bytes written."]
    received_bytes: Annotated[int, "Bytes read."]


def measure_bucket(bucket: Bucket, seconds: float) -> BucketSpeed:
    """Write, read and delete objects for about so many seconds.

    Objects of a killed measurement, older than an hour, are deleted, too.

    Raises:
        StorageError: The bucket cannot be written or read.
    """
    folder = f"{_PLACE}{uuid.uuid4().hex}/"
    _delete_leftovers(bucket)
    try:
        times = _small(bucket, folder, seconds / 3)
        large = _large(bucket, folder, seconds * 2 / 3)
    finally:
        bucket.delete([info.key for info in bucket.list(folder)])
    return BucketSpeed(
        put_mb_per_s=large.total_bytes / max(large.put_s, _SHORTEST_S) / 1e6,
        get_mb_per_s=large.total_bytes / max(large.get_s, _SHORTEST_S) / 1e6,
        requests_per_s=len(times) / max(sum(times), _SHORTEST_S),
        request_ms=1000 * statistics.median(times),
        requests=len(times) + 1 + 3 * large.objects + 3,  # two lists and a deletion
        sent_bytes=large.total_bytes + (len(times) // 2 + 1) * SMALL_BYTES,
        received_bytes=large.total_bytes + len(times) // 2 * SMALL_BYTES,
    )


_PLACE = f"{TEST_FOLDER}-bench/"


def _small(bucket: Bucket, folder: str, seconds: float) -> list[float]:
    times: list[float] = []
    data = os.urandom(SMALL_BYTES)
    key = f"{folder}small"
    bucket.put(key, data)  # opens the connection
    began_s = time.perf_counter()
    while len(times) < 2 or (
        len(times) < MOST_REQUESTS and time.perf_counter() - began_s < seconds
    ):
        before_s = time.perf_counter()
        bucket.put(key, data)
        between_s = time.perf_counter()
        bucket.get(key)
        times += [between_s - before_s, time.perf_counter() - between_s]
    return times


@dataclass(frozen=True)
class _Large:
    objects: int
    total_bytes: int
    put_s: float
    get_s: float


def _large(bucket: Bucket, folder: str, seconds: float) -> _Large:
    total = count = 0
    put_s = get_s = 0.0
    began_s = time.perf_counter()
    for number in range(MOST_BYTES // LARGE_BYTES[0]):
        size = LARGE_BYTES[min(number, len(LARGE_BYTES) - 1)]
        left_s = began_s + seconds - time.perf_counter()
        # The next object must fit into the time that is left, at the speed so far.
        if count and (total + size > MOST_BYTES or (put_s + get_s) / total * size > left_s):
            break
        key, data = f"{folder}{number}", os.urandom(size)
        before_s = time.perf_counter()
        bucket.put(key, data)
        put_s += time.perf_counter() - before_s
        before_s = time.perf_counter()
        bucket.get(key)
        get_s += time.perf_counter() - before_s
        bucket.delete([key])
        total += size
        count += 1
    return _Large(count, total, put_s, get_s)


def _delete_leftovers(bucket: Bucket) -> None:
    latest = datetime.now(UTC) - _LEFTOVER_AGE
    bucket.delete([info.key for info in bucket.list(_PLACE) if info.modified < latest])


# The bucket that `dr bench` measures.


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

"""A bucket on any S3 server; calls repeat while it restarts."""

import copy
import io
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from email.utils import parsedate_to_datetime
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeVar

from drcli.base import errors
from drcli.base.clock import delays_s
from drcli.base.errors import DiskFull, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.system_calls import flush_to_disk, is_disk_full
from drcli.bucket.bucket import (
    Listing,
    ObjectInfo,
    ObjectMissing,
    Watch,
    checked_folder,
    keys_above,
    without_placeholders,
)
from drcli.bucket.endpoint import Endpoint, lend_to_refreshes, session_of
from drcli.bucket.request_count import counter
from drcli.bucket.s3_errors import (
    MISSING_CODES,
    Attempt,
    blocked,
    explain,
    explain_entry,
    hides_its_code,
    local_trouble,
    needs_folder,
    passes,
    patience_share,
)
from drcli.config import secret_environment

if TYPE_CHECKING:
    from mypy_boto3_s3.client import S3Client

with lazy_imports():
    from boto3 import exceptions as boto3_exceptions
    from boto3.s3 import transfer as s3_transfer
    from botocore import config as botocore_config
    from botocore import exceptions as boto
    from botocore import parsers as botocore_parsers

# Says only once that a server does not answer.


_SAID_AGAIN_S = 60.0
_LONG_S = 10.0


class Outage:
    """Says once that a server is silent, and once that it is back."""

    def __init__(self, place: str, clock: Callable[[], float]) -> None:
        self._place = place
        self._clock = clock
        self._lock = threading.Lock()
        self._began_s: float | None = None
        self._told_s = -_SAID_AGAIN_S

    def note(self, began_s: float, reason: str = "") -> None:
        with self._lock:
            if self._began_s is not None:
                return
            self._began_s = began_s
            now_s = self._clock()
            told = now_s - self._told_s < _SAID_AGAIN_S
            self._told_s = now_s
        if not told:
            errors.show(reason or f"Waiting for an answer from {self._place} ...")

    def end(self) -> None:
        if self._began_s is None:
            return
        with self._lock:
            began_s, self._began_s = self._began_s, None
            now_s = self._clock()
            self._told_s = now_s
        if began_s is not None and now_s - began_s >= _LONG_S:
            errors.show(f"{self._place} answers again, after {now_s - began_s:.0f} s.")


@lru_cache(maxsize=16)
def outage_of(place: str, clock: Callable[[], float]) -> Outage:
    """Shared by all buckets and threads of this process."""
    return Outage(place, clock)


# Brings the objects of a local bucket to its disk, so that a power cut leaves them.
#
# rclone writes files without flushing, and deletes an old file before renaming the new one, so
# file systems ignore their order: for half a minute, a power cut leaves an empty file. So each
# process flushes what it wrote at once, in a thread; who relies on it waits (`flush`).


class DiskFlush:
    """Flushes the files of a bucket's folder. Thread-safe."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()
        self._lock = threading.Lock()
        self._written: dict[str, None] = {}
        self._known_folders: set[Path] = set()
        self._failure: tuple[Path, OSError] | None = None
        # Python waits for it at the end of a process.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="disk-flush")

    def note(self, key: str) -> None:
        """Flush an object that was just written, soon."""
        if not outlives_power_cut(key):
            return
        with self._lock:
            is_expected = bool(self._written)
            self._written[key] = None
        if not is_expected:
            self._begin()

    def flush(self) -> None:
        """Wait until all noted objects are on the disk.

        Raises:
            StorageError: One is not, or was not earlier.
        """
        self._begin().result()
        with self._lock:
            failure, self._failure = self._failure, None
        if failure is not None:
            raise _explained(*failure)

    def _begin(self) -> Future[None]:
        try:
            return self._thread.submit(self._flush_written)
        except RuntimeError:  # the process is ending, and starts no thread any more
            self._flush_written()
            done: Future[None] = Future()
            done.set_result(None)
            return done

    def _flush_written(self) -> None:
        with self._lock:
            written, self._written = list(self._written), {}
        folders: dict[Path, None] = {}
        for key in written:
            path = self._folder / key
            self._flush(path)
            folders[path.parent] = None
            # A name is on the disk when its folder is, and that of a new folder when its own is.
            for folder in path.parents:
                if folder in self._known_folders or folder == self._folder.parent.parent:
                    break
                self._known_folders.add(folder)
                folders[folder] = None
        for folder in folders:
            self._flush(folder)

    def _flush(self, path: Path) -> None:
        try:
            flush_to_disk(path)
        except FileNotFoundError:
            pass  # it was deleted, or another one is taking its place, which will be noted
        except OSError as error:
            with self._lock:
                self._failure = path, error
            errors.warn(str(_explained(path, error)))


def _explained(path: Path, error: OSError) -> StorageError:
    if is_disk_full(error):
        return DiskFull(
            f"{path} was written, but has no room on the disk.",
            remedy="Make room, for example by deleting old models, then continue the run.",
        )
    return StorageError(
        f"{path} was written, but it is not on the disk: {error.strerror or error} "
        "(DR_S3_DATA_DIR).",
        remedy="Check that disk (`dmesg` tells of its errors), or set DR_S3_DATA_DIR to a folder "
        "on another one.",
    )


def outlives_power_cut(key: str) -> bool:
    """Whether an object is flushed to the disk: all but those that are of no use afterwards.

    Rollouts are many and driven again, and processes write anew what they say of themselves.
    """
    of_processes = key.startswith("runs/") and key.split("/")[-2] in ("status", "members")
    return not (key.startswith("rollouts/") or of_processes)


MULTIPART_FROM_BYTES = 64 << 20
"""Smaller ones are one request, kept completely or not at all."""

PART_BYTES = 16 << 20
HURRIED_PATIENCE_S = 2.0
"""Once asked to stop."""

_READ_BYTES = 1 << 18
_CONNECT_TIMEOUT_S = 5
_PAGE_KEYS = 1000
"""S3's limit for listing and deleting."""

T = TypeVar("T")


class S3Bucket:
    """A bucket through boto3. Thread-safe.

    Args:
        endpoint: Server and keys.
        name: Of the bucket.
        patience_s: For a silent server; supervisors restart a local one in seconds.
        read_timeout_s: For a stalled answer.
        hurried: Asked to stop, so hardly repeat.
        unattended: Also wait for the clock or access keys.
        clock: Monotonic.
        pause: Waits.

    Raises:
        StorageError: The profile does not exist.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        name: str,
        *,
        patience_s: float = 60.0,
        read_timeout_s: float = 60.0,
        hurried: Callable[[], bool] = lambda: False,
        unattended: bool = False,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self.endpoint = endpoint
        self.name = name
        self._patience_s = patience_s
        self._hurried = hurried
        self._unattended = unattended
        self._before_write: Callable[[str], None] = lambda key: None
        self._clock = clock
        self._pause = pause
        self._read_timeout_s = read_timeout_s
        self._client = _client(endpoint, read_timeout_s)
        self._outage = outage_of(endpoint.place, clock)
        self._disk: DiskFlush | None = None
        if endpoint.engine == "rclone" and endpoint.data_dir is not None:
            self._disk = DiskFlush(endpoint.data_dir / name)

    def close(self) -> None:
        self._client.close()

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        return self._retry(lambda: self._get(key, watch), "read", key)[0]

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        return self._retry(lambda: self._get(key), "read", key)

    def fenced(self, check: Callable[[str], None]) -> Self:
        """The same, but calls `check` with each key before writing or deleting.

        Its error ends the call. Repeated calls check again: a minute may pass.
        """
        fenced = copy.copy(self)
        fenced._before_write = check
        return fenced

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """One request below 64 MiB, parts above."""
        if watch is None and len(data) < MULTIPART_FROM_BYTES:
            call = partial(self._put_whole, key, data)
        else:
            call = partial(self._put_in_parts, key, data, watch)
        write = partial(self._retry, call, "write", key, len(data))
        try:
            write()
        except StorageError as error:
            if not needs_folder(error.__cause__) or not self._deleted_above(key):
                raise
            write()
        if self._disk is not None:
            self._disk.note(key)

    def flush(self) -> None:
        """Wait until all is on the disk, if local files.

        Raises:
            StorageError: The disk refused some.
        """
        if self._disk is not None:
            self._disk.flush()

    def delete(self, keys: Iterable[str]) -> None:
        everything = tuple(keys)
        for start in range(0, len(everything), _PAGE_KEYS):
            batch = everything[start : start + _PAGE_KEYS]
            self._retry(partial(self._delete_batch, batch), "delete", batch[0])

    def exists(self, key: str) -> bool:
        try:
            self._retry(partial(self._look_up, key), "look up", key)
        except ObjectMissing:
            return False
        return True

    def list(self, folder: str) -> Listing:
        call = partial(self._list_all, checked_folder(folder))
        return self._retry(call, "list", folder)

    def accepts_keys(self) -> bool:
        """Whether it answers now and accepts our keys."""
        try:
            self._client.list_buckets()
        except (boto.BotoCoreError, boto.ClientError):
            return False
        return True

    def is_created(self) -> bool:
        def look() -> bool:
            try:
                self._client.head_bucket(Bucket=self.name)
            except boto.ClientError as e:
                if e.response["Error"]["Code"] not in MISSING_CODES:
                    raise
                return False
            return True

        return self._retry(look, "look up", "")

    def ensure_exists(self) -> None:
        if not self.is_created():
            self._retry(partial(self._client.create_bucket, Bucket=self.name), "create", "")

    @property
    def client(self) -> "S3Client":
        """For requests that no other method makes; not repeated."""
        return self._client

    def _retry(
        self,
        call: Callable[[], T],
        action: str,
        key: str,
        size_bytes: int = 0,
        *,
        patient: bool = True,
    ) -> T:
        failures = (
            boto.BotoCoreError,
            boto.ClientError,
            botocore_parsers.ResponseParserError,
            boto3_exceptions.Boto3Error,
            ConnectionError,
        )
        started_s = self._clock()
        delays = delays_s()
        ours = self.endpoint.engine is not None
        while True:
            try:
                result = call()
                self._outage.end()
                return result
            except failures as e:
                patience_s = self._patience_s * patience_share(
                    e, ours=ours, unattended=self._unattended
                )
                if not patient:
                    patience_s = 0.0
                if self._hurried():
                    patience_s = min(patience_s, HURRIED_PATIENCE_S)
                waited_s = self._clock() - started_s
                left_s = patience_s - waited_s
                if left_s <= 0:
                    attempt = Attempt(action, self.endpoint, self.name, key, size_bytes)
                    raise explain(e, attempt) from e
                if waited_s > errors.QUIET_S:
                    self._outage.note(started_s, local_trouble(e, self.endpoint))
                self._pause(min(next(delays), left_s))
                if isinstance(e, boto.NoCredentialsError):  # a client looks for keys only once
                    self._client = _client(self.endpoint, self._read_timeout_s)

    def _look_up(self, key: str) -> int:
        try:
            return self._client.head_object(Bucket=self.name, Key=key)["ContentLength"]
        except boto.ClientError as e:
            if not hides_its_code(e):
                raise
            answer = self._client.get_object(Bucket=self.name, Key=key)
            answer["Body"].close()
            return answer["ContentLength"]

    def _get(self, key: str, watch: Watch | None = None) -> tuple[bytes, float | None]:
        answer = self._client.get_object(Bucket=self.name, Key=key)
        body, age_s = answer["Body"], None
        with suppress(KeyError, TypeError, ValueError):  # a server without these dates
            now = parsedate_to_datetime(answer["ResponseMetadata"]["HTTPHeaders"]["date"])
            age_s = max(0.0, (now - answer["LastModified"]).total_seconds())
        if watch is None:
            return body.read(), age_s
        with _counting(watch) as count:
            chunks = []
            for chunk in body.iter_chunks(_READ_BYTES):
                chunks.append(chunk)
                count(len(chunk))
        return b"".join(chunks), age_s

    def _deleted_above(self, key: str) -> bool:
        """Delete the empty object where our server needs a folder.

        S3 browsers write `model/`; servers with plain files make a file `model` of it, and refuse
        all below.

        Raises:
            StorageError: It has content, or the server is another.
        """
        for above in keys_above(key):
            try:
                # The write has waited already if the server is busy.
                size = self._retry(partial(self._look_up, above), "look up", above, patient=False)
            except StorageError:
                continue
            if size or self.endpoint.engine is None:
                raise blocked(Attempt("write", self.endpoint, self.name, key), above, size)
            self.delete([above])
            errors.warn(
                f"Deleted the empty object {self.name}/{above}, which another program wrote for a "
                f"folder: nothing could be written below it."
            )
            return True
        return False

    def _put_whole(self, key: str, data: bytes) -> None:
        self._before_write(key)
        self._client.put_object(Bucket=self.name, Key=key, Body=data)

    def _put_in_parts(self, key: str, data: bytes, watch: Watch | None) -> None:
        self._before_write(key)
        # No threads: the embedded server writes parts to disk in their order, and would keep those
        # that come too early in memory.
        config = s3_transfer.TransferConfig(
            multipart_threshold=MULTIPART_FROM_BYTES,
            multipart_chunksize=PART_BYTES,
            use_threads=False,
        )
        with _counting(watch) as count:
            self._client.upload_fileobj(
                io.BytesIO(data), self.name, key, Config=config, Callback=count
            )

    def _delete_batch(self, keys: Sequence[str]) -> None:
        for key in keys:
            self._before_write(key)
        answer = self._client.delete_objects(
            Bucket=self.name, Delete={"Objects": [{"Key": key} for key in keys], "Quiet": True}
        )
        for failure in answer.get("Errors", []):
            if passes(failure.get("Code", "")):
                # As an answer of its own, so that `_retry` asks again.
                # The ignored check: the types want what only botocore adds.
                response = {"Error": failure, "ResponseMetadata": answer["ResponseMetadata"]}
                raise boto.ClientError(response, "DeleteObjects")  # type: ignore[arg-type]
            if failure.get("Code") not in MISSING_CODES:
                attempt = Attempt("delete", self.endpoint, self.name, str(failure.get("Key")))
                raise explain_entry(failure.get("Code", ""), failure.get("Message", ""), attempt)

    def _list_all(self, folder: str) -> Listing:
        pages = self._client.get_paginator("list_objects_v2").paginate(
            Bucket=self.name, Prefix=folder, PaginationConfig={"PageSize": _PAGE_KEYS}
        )
        return without_placeholders(
            ObjectInfo(item["Key"], item["Size"], item["ETag"].strip('"'), item["LastModified"])
            for page in pages
            for item in page.get("Contents", [])
        )


@contextmanager
def _counting(watch: Watch | None) -> Iterator[Watch]:
    total = 0

    def count(more: int) -> None:
        nonlocal total
        total += more
        if watch is not None:
            watch(more)

    try:
        yield count
    except BaseException:
        count(-total)
        raise


_making_clients = threading.Lock()
"""Threads may share clients, not create them."""


def _client(endpoint: Endpoint, read_timeout_s: float) -> "S3Client":
    config = botocore_config.Config(
        # We repeat calls, not botocore, so that one clock limits the wait.
        retries={"total_max_attempts": 1, "mode": "standard"},
        connect_timeout=_CONNECT_TIMEOUT_S,
        read_timeout=read_timeout_s,
        max_pool_connections=16,
        # Some other servers do not know the newer checksums.
        request_checksum_calculation="when_required",
        response_checksum_validation="when_required",
        s3={"addressing_style": "auto" if endpoint.url is None else "path"},
    )
    session = session_of(endpoint.profile, endpoint.names.profile)
    try:
        with _making_clients, secret_environment.lent():
            client = session.client(
                "s3",
                endpoint_url=endpoint.url,
                region_name=endpoint.region,
                aws_access_key_id=endpoint.access_key,
                aws_secret_access_key=endpoint.secret_key,
                config=config,
            )
            if endpoint.access_key is None:
                lend_to_refreshes(session.get_credentials())
            counter.attach(client)
            return client
    except (boto.BotoCoreError, ValueError, AttributeError) as e:  # the last for `s3 = text`
        raise StorageError(
            f"The AWS library cannot use region, address or profile of {endpoint.place} "
            f"({endpoint.names.profile} is '{endpoint.profile or ''}'): {e}.",
            remedy="Correct that profile in ~/.aws/config.",
        ) from e

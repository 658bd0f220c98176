"""A bucket on any S3 server, which waits for a server that is starting again."""

import copy
import io
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from email.utils import parsedate_to_datetime
from functools import partial
from typing import TYPE_CHECKING, Self, TypeVar

from drcli.base import notices
from drcli.base.backoff import delays_s
from drcli.base.errors import StorageError
from drcli.config import secret_environment
from drcli.store.bucket import Listing, ObjectInfo, ObjectMissing, Watch, checked_folder
from drcli.store.endpoint import Endpoint
from drcli.store.profiles import lend_to_refreshes, session_of
from drcli.store.s3_errors import MISSING_CODES, Attempt, explain, patience_share

if TYPE_CHECKING:
    from mypy_boto3_s3.client import S3Client

MULTIPART_FROM_BYTES = 64 << 20
"""Below this an object travels in one request, which a server either keeps whole or not at all."""

PART_BYTES = 16 << 20
HURRIED_PATIENCE_S = 2.0
"""How long a call may go on asking a silent server once its process was asked to leave."""

_READ_BYTES = 1 << 18
_CONNECT_TIMEOUT_S = 5
_PAGE_KEYS = 1000
"""S3 lists and deletes no more keys in one request."""

T = TypeVar("T")


class S3Bucket:
    """A bucket of any S3 server, over boto3. May be used by several threads at once.

    Args:
        endpoint: Server and keys.
        name: Bucket.
        patience_s: For how long a server that does not answer is asked again before the call
            fails; a supervisor starts a dead local server within seconds.
        read_timeout_s: For how long an answer may stall.
        hurried: Whether this process was asked to leave: its patience is short from then on.
        clock: Monotonic seconds, for tests.
        pause: Waits the given seconds, for tests.

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
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self._endpoint = endpoint
        self._name = name
        self._patience_s = patience_s
        self._hurried = hurried
        self._before_write: Callable[[str], None] = lambda key: None
        self._clock = clock
        self._pause = pause
        self._client = _client(endpoint, read_timeout_s)

    @property
    def name(self) -> str:
        """Name of the bucket."""
        return self._name

    @property
    def endpoint(self) -> Endpoint:
        """The server behind it."""
        return self._endpoint

    def close(self) -> None:
        """Close the connections; not needed where the process ends anyway."""
        self._client.close()

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """Read a whole object; ObjectMissing when there is none."""
        return self._patiently(lambda: self._get(key, watch), self._attempt("read", key))

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """Read a whole object, and how many seconds ago it was written by the server's clock."""
        return self._patiently(lambda: self._get_with_age(key), self._attempt("read", key))

    def fenced(self, check: Callable[[str], None]) -> Self:
        """The same bucket, which calls `check` with every key that it is to write or delete.

        It is called before every try, because between two of them a minute may pass. What it raises
        ends the call.
        """
        fenced = copy.copy(self)
        fenced._before_write = check
        return fenced

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """Write an object, in one request below 64 MiB and in parts above."""
        if watch is None and len(data) < MULTIPART_FROM_BYTES:
            call = partial(self._put_whole, key, data)
        else:
            call = partial(self._put_in_parts, key, data, watch)
        self._patiently(call, self._attempt("write", key, len(data)))

    def delete(self, keys: Iterable[str]) -> None:
        """Delete objects, a thousand in a request."""
        doomed = tuple(keys)
        for start in range(0, len(doomed), _PAGE_KEYS):
            batch = doomed[start : start + _PAGE_KEYS]
            self._patiently(partial(self._delete_batch, batch), self._attempt("delete", batch[0]))

    def exists(self, key: str) -> bool:
        """Whether there is an object under this key."""
        try:
            self._patiently(
                lambda: self._client.head_object(Bucket=self._name, Key=key),
                self._attempt("look up", key),
            )
        except ObjectMissing:
            return False
        return True

    def list(self, folder: str) -> Listing:
        """All objects below a folder (which ends with a slash), sorted by key."""
        return self._patiently(
            lambda: self._list_all(checked_folder(folder)), self._attempt("list", folder)
        )

    def accepts_keys(self) -> bool:
        """Whether a server answers now and accepts our access keys."""
        from botocore.exceptions import BotoCoreError, ClientError

        try:
            self._client.list_buckets()
        except (BotoCoreError, ClientError):
            return False
        return True

    def ensure_exists(self) -> None:
        """Create the bucket where it is missing; only on our own server."""
        from botocore.exceptions import ClientError

        def ensure() -> None:
            try:
                self._client.head_bucket(Bucket=self._name)
            except ClientError as e:
                if e.response["Error"]["Code"] not in MISSING_CODES:
                    raise
                self._client.create_bucket(Bucket=self._name)

        self._patiently(ensure, self._attempt("create", ""))

    def probe(self) -> None:
        """Prove that objects can be written, read, listed and deleted, before a run relies on it.

        Raises:
            StorageError: They cannot; the sentence says which and why.
        """
        self._patiently(
            lambda: self._client.head_bucket(Bucket=self._name), self._attempt("open", "")
        )
        folder = f".probe-{uuid.uuid4().hex}/"
        key, content = folder + "object", b"probe"
        self.put(key, content)
        try:
            if self.get(key) != content or [o.key for o in self.list(folder)] != [key]:
                raise StorageError(
                    f"{self._endpoint.place} does not give back what was written to "
                    f"'{self._name}' ({self._endpoint.names.bucket}).",
                    remedy="Use another S3 server; this one would lose a model.",
                )
        finally:
            self.delete([key])

    def _attempt(self, action: str, key: str, size_bytes: int = 0) -> Attempt:
        return Attempt(action, self._endpoint, self._name, key, size_bytes)

    def _patiently(self, call: Callable[[], T], attempt: Attempt) -> T:
        """Call, and call again while the failure is of the kind that passes."""
        from boto3.exceptions import Boto3Error
        from botocore.exceptions import BotoCoreError, ClientError

        started_s = self._clock()
        delays = delays_s()
        shown = False
        while True:
            try:
                return call()
            except (BotoCoreError, ClientError, Boto3Error, ConnectionError) as e:
                patience_s = self._patience_s * patience_share(e)
                if self._hurried():
                    patience_s = min(patience_s, HURRIED_PATIENCE_S)
                waited_s = self._clock() - started_s
                left_s = patience_s - waited_s
                if left_s <= 0:
                    raise explain(e, attempt) from e
                if not shown and waited_s > notices.QUIET_S:
                    shown = True
                    notices.show(
                        f"No good answer from {self._endpoint.place} yet; trying again ..."
                    )
                self._pause(min(next(delays), left_s))

    def _get(self, key: str, watch: Watch | None) -> bytes:
        body = self._client.get_object(Bucket=self._name, Key=key)["Body"]
        if watch is None:
            return body.read()
        with _counting(watch) as count:
            chunks = []
            for chunk in body.iter_chunks(_READ_BYTES):
                chunks.append(chunk)
                count(len(chunk))
        return b"".join(chunks)

    def _get_with_age(self, key: str) -> tuple[bytes, float | None]:
        answer = self._client.get_object(Bucket=self._name, Key=key)
        written = answer.get("LastModified")
        now = answer["ResponseMetadata"]["HTTPHeaders"].get("date")
        age_s = None
        if written is not None and now is not None:
            age_s = max(0.0, (parsedate_to_datetime(now) - written).total_seconds())
        return answer["Body"].read(), age_s

    def _put_whole(self, key: str, data: bytes) -> None:
        self._before_write(key)
        self._client.put_object(Bucket=self._name, Key=key, Body=data)

    def _put_in_parts(self, key: str, data: bytes, watch: Watch | None) -> None:
        """Write an object with the library that cuts large ones into parts and counts bytes."""
        from boto3.s3.transfer import TransferConfig

        self._before_write(key)
        # One part after the other: the embedded server writes them to disk in that order and
        # would have to hold back in memory what comes too early.
        config = TransferConfig(
            multipart_threshold=MULTIPART_FROM_BYTES,
            multipart_chunksize=PART_BYTES,
            use_threads=False,
        )
        with _counting(watch) as count:
            self._client.upload_fileobj(
                io.BytesIO(data), self._name, key, Config=config, Callback=count
            )

    def _delete_batch(self, keys: Sequence[str]) -> None:
        for key in keys:
            self._before_write(key)
        answer = self._client.delete_objects(
            Bucket=self._name, Delete={"Objects": [{"Key": key} for key in keys], "Quiet": True}
        )
        for failure in answer.get("Errors", []):
            if failure.get("Code") not in MISSING_CODES:
                raise StorageError(
                    f"Cannot delete {self._name}/{failure.get('Key')} at {self._endpoint.place}: "
                    f"{failure.get('Code')} {failure.get('Message')}.",
                    remedy="Check that the access keys may delete.",
                )

    def _list_all(self, folder: str) -> Listing:
        pages = self._client.get_paginator("list_objects_v2").paginate(
            Bucket=self._name, Prefix=folder, PaginationConfig={"PageSize": _PAGE_KEYS}
        )
        found = [
            ObjectInfo(item["Key"], item["Size"], item["ETag"].strip('"'), item["LastModified"])
            for page in pages
            for item in page.get("Contents", [])
        ]
        return sorted(found, key=lambda info: info.key)


@contextmanager
def _counting(watch: Watch | None) -> Iterator[Watch]:
    """Pass on how many bytes were transferred, and take it back when the transfer failed."""
    travelled = 0

    def count(more: int) -> None:
        nonlocal travelled
        travelled += more
        if watch is not None:
            watch(more)

    try:
        yield count
    except BaseException:
        count(-travelled)
        raise


_making_clients = threading.Lock()
"""Clients may be shared by threads, but not made by several at once."""


def _client(endpoint: Endpoint, read_timeout_s: float) -> "S3Client":
    from botocore.config import Config
    from botocore.exceptions import BotoCoreError

    config = Config(
        # Repeated here, not by botocore, so that one clock bounds the wait.
        retries={"total_max_attempts": 1, "mode": "standard"},
        connect_timeout=_CONNECT_TIMEOUT_S,
        read_timeout=read_timeout_s,
        max_pool_connections=16,
        # Other servers than Amazon's do not all know the newer checksums.
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
            return client
    except (BotoCoreError, ValueError, AttributeError) as e:  # the last for a section that is none
        raise StorageError(
            f"The AWS library cannot use region, address or profile of {endpoint.place} "
            f"({endpoint.names.profile} is '{endpoint.profile or ''}'): {e}.",
            remedy="Correct that profile in ~/.aws/config.",
        ) from e

"""Tries what drcli does with a bucket, folder by folder, and measures the speed.

Test objects are deleted; where that fails, one stays in each folder, always the same.
"""

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from statistics import median
from typing import Any, Literal

from drcli.base.errors import StorageError
from drcli.base.process_identity import this_machine
from drcli.store.bucket import TEST_FOLDER, ObjectMissing
from drcli.store.s3_bucket import S3Bucket
from drcli.store.s3_errors import AccessRefused, Attempt, explain

Action = Literal["write", "read", "overwrite", "list", "delete", "multipart"]

_ROUND_TRIPS = 5
_SPEED_BYTES = (1 << 16, 1 << 19, 1 << 22, 1 << 24)
_LONG_S = 0.3
_RESERVE_S = 0.5


@dataclass(frozen=True)
class Refused:
    folder: str
    action: Action
    reason: str
    remedy: str


@dataclass
class Trial:
    """What was found out about a bucket.

    Attributes:
        round_trip_ms: Median, small object.
        conditional: The server refuses to overwrite if asked so; drcli does not need it.
        wrong: What it did that loses data.
        left: Test objects that could not be deleted.
        late: Time ran out.
    """

    worked: list[str] = field(default_factory=list)
    refused: list[Refused] = field(default_factory=list)
    round_trip_ms: float | None = None
    write_mb_s: float | None = None
    read_mb_s: float | None = None
    clock_ahead_s: float | None = None
    conditional: bool | None = None
    wrong: str = ""
    left: list[str] = field(default_factory=list)
    late: bool = False


def try_bucket(bucket: S3Bucket, folders: Sequence[str], *, seconds: float) -> Trial:
    """Try everything in each folder, then measure speed in the first that works.

    After `seconds`, nothing more is begun.

    Raises:
        StorageError: The server cannot be reached, does not know the keys, or has no such bucket.
    """
    return _Attempts(bucket, folders, time.monotonic() + seconds).all()


class _OutOfTime(Exception):
    """No time for another attempt."""


class _Attempts:
    def __init__(self, bucket: S3Bucket, folders: Sequence[str], deadline_s: float) -> None:
        self._bucket = bucket
        self._deadline_s = deadline_s
        self._trial = Trial()
        self._answered = False
        self._folders = folders
        name = hashlib.sha256(this_machine().encode()).hexdigest()[:8]
        self._place = f"{TEST_FOLDER}-{name}/"
        bucket.client.meta.events.register("after-call.s3", self._read_clock)

    def all(self) -> Trial:
        trial = self._trial
        try:
            for folder in self._folders:
                if self._try_folder(folder):
                    trial.worked.append(folder)
            if trial.worked and not trial.wrong:
                self._try_parts(trial.worked[0])
                self._measure(f"{trial.worked[0]}{self._place}speed.bin")
        except _OutOfTime:
            trial.late = True
        return trial

    def _try_folder(self, folder: str) -> bool:
        refused = len(self._trial.refused)
        test, key = f"{folder}{self._place}", f"{folder}{self._place}object.txt"
        first, second = os.urandom(64), os.urandom(64)
        put, get = self._bucket.put, self._bucket.get
        if not self._allowed("write", folder, lambda: put(key, first)):
            self._allowed("list", folder, lambda: self._bucket.list(test))
            return False
        try:
            self._allowed("read", folder, lambda: self._expect(get(key) == first))
            if self._allowed("overwrite", folder, lambda: put(key, second)):
                self._allowed("read", folder, lambda: self._expect(get(key) == second))
            self._allowed("list", folder, lambda: self._expect(self._lists(test, key)))
            if self._trial.round_trip_ms is None:
                self._measure_round_trip(key)
                self._try_condition(key)
        finally:
            deleted = self._allowed("delete", folder, lambda: self._delete(key), always=True)
        if deleted and not self._is_refused(folder, "list"):
            self._allowed("list", folder, lambda: self._expect(not self._lists(test, key)))
        return len(self._trial.refused) == refused

    def _allowed(
        self, action: Action, folder: str, call: Callable[[], object], *, always: bool = False
    ) -> bool:
        """Record a refusal once; StorageError if the server never answered."""
        if not always:
            self._check_time()
        try:
            call()
        except AccessRefused as error:
            reason, remedy = error.reason, error.below(self._folders).remedy
        except ObjectMissing:
            self._expect(False)
            return False
        except StorageError as error:
            if not self._answered:
                raise
            reason, remedy = str(error).removesuffix("."), error.remedy
        else:
            self._answered = True
            return True
        self._answered = True
        if not self._is_refused(folder, action):
            self._trial.refused.append(Refused(folder, action, reason, remedy))
        return False

    def _is_refused(self, folder: str, action: Action) -> bool:
        return any(each.folder == folder and each.action == action for each in self._trial.refused)

    def _expect(self, as_written: bool) -> None:
        if not as_written:
            self._trial.wrong = "it does not return, list or delete objects as they were written"

    def _lists(self, folder: str, key: str) -> bool:
        return key in [item.key for item in self._bucket.list(folder)]

    def _delete(self, key: str) -> None:
        self._trial.left.append(key)
        self._bucket.delete([key])
        self._trial.left.remove(key)

    def _measure_round_trip(self, key: str) -> None:
        times = []
        with suppress(StorageError):
            for _ in range(_ROUND_TRIPS):
                self._check_time()
                began_s = time.monotonic()
                self._bucket.get(key)
                times.append(1000 * (time.monotonic() - began_s))
        self._trial.round_trip_ms = median(times) if times else None

    def _try_condition(self, key: str) -> None:
        from botocore.exceptions import BotoCoreError, ClientError

        self._check_time()
        client, name = self._bucket.client, self._bucket.name
        try:
            client.put_object(Bucket=name, Key=key, Body=b"", IfNoneMatch="*")
        except ClientError as error:
            status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode")
            self._trial.conditional = True if status in (409, 412) else None
        except (BotoCoreError, TypeError):
            self._trial.conditional = None
        else:
            self._trial.conditional = False

    def _try_parts(self, folder: str) -> None:
        from botocore.exceptions import BotoCoreError, ClientError

        self._check_time()
        client, name, key = self._bucket.client, self._bucket.name, f"{folder}{self._place}parts"
        upload = ""
        try:
            upload = client.create_multipart_upload(Bucket=name, Key=key)["UploadId"]
            part = client.upload_part(
                Bucket=name, Key=key, UploadId=upload, PartNumber=1, Body=b"part"
            )
            client.complete_multipart_upload(
                Bucket=name,
                Key=key,
                UploadId=upload,
                MultipartUpload={"Parts": [{"ETag": part["ETag"], "PartNumber": 1}]},
            )
            self._expect(self._bucket.get(key) == b"part")
        except (BotoCoreError, ClientError, StorageError) as error:
            wrong = (
                error
                if isinstance(error, StorageError)
                else explain(error, Attempt("write", self._bucket.endpoint, name, key))
            )
            reason = getattr(wrong, "reason", str(wrong).removesuffix("."))
            self._trial.refused.append(Refused(folder, "multipart", reason, wrong.remedy))
            with suppress(BotoCoreError, ClientError):
                if upload:
                    client.abort_multipart_upload(Bucket=name, Key=key, UploadId=upload)
        finally:
            with suppress(StorageError):
                self._delete(key)

    def _measure(self, key: str) -> None:
        """Objects are such that no server can compress them."""
        trial = self._trial
        try:
            for size in _SPEED_BYTES:
                self._check_time()
                data = os.urandom(size)
                began_s = time.monotonic()
                self._bucket.put(key, data)
                took_s = time.monotonic() - began_s
                trial.write_mb_s = size / 1e6 / max(1e-6, took_s)
                # The next one takes up to eight times as long.
                if took_s > _LONG_S or self._left_s() < 8 * took_s:
                    break
            self._check_time()
            began_s = time.monotonic()
            size = len(self._bucket.get(key))
            trial.read_mb_s = size / 1e6 / max(1e-6, time.monotonic() - began_s)
        except StorageError:
            pass  # what fails now and then worked before
        finally:
            with suppress(StorageError):
                self._delete(key)

    def _left_s(self) -> float:
        return self._deadline_s - _RESERVE_S - time.monotonic()

    def _check_time(self) -> None:
        if self._left_s() < 0:
            raise _OutOfTime

    def _read_clock(self, http_response: Any = None, **_: Any) -> None:
        said = getattr(http_response, "headers", {}).get("date")
        if said is None:
            return
        with suppress(ValueError, TypeError):
            # The server's time is that of a whole second.
            ahead_s = time.time() - parsedate_to_datetime(said).timestamp() - 0.5
            self._trial.clock_ahead_s = ahead_s

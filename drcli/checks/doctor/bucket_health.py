"""Examines a bucket: answers, speed, clock and permissions."""

import hashlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from itertools import groupby
from statistics import median
from typing import Any, Literal

from drcli.base.errors import StorageError
from drcli.base.installation import lazy_imports
from drcli.base.processes import this_machine
from drcli.bucket.bucket import TEST_FOLDER, ObjectMissing
from drcli.bucket.connect import open_bucket, open_upload_bucket
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.s3_errors import AccessRefused, Attempt, explain
from drcli.checks.doctor.findings import Finding
from drcli.checks.start_rules import LARGEST_SKEW_S, review_minio_folder
from drcli.config.run_config import StorageConfig
from drcli.config.settings import Settings
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore

with lazy_imports():
    from botocore import exceptions as boto

# Tries what drcli does with a bucket, folder by folder, and measures the speed.
#
# Test objects are deleted; where that fails, one stays in each folder, always the same.


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
        self._check_time()
        client, name = self._bucket.client, self._bucket.name
        try:
            client.put_object(Bucket=name, Key=key, Body=b"", IfNoneMatch="*")
        except boto.ClientError as error:
            status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode")
            self._trial.conditional = True if status in (409, 412) else None
        except (boto.BotoCoreError, TypeError):
            self._trial.conditional = None
        else:
            self._trial.conditional = False

    def _try_parts(self, folder: str) -> None:
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
        except (boto.BotoCoreError, boto.ClientError, StorageError) as error:
            wrong = (
                error
                if isinstance(error, StorageError)
                else explain(error, Attempt("write", self._bucket.endpoint, name, key))
            )
            reason = getattr(wrong, "reason", str(wrong).removesuffix("."))
            self._trial.refused.append(Refused(folder, "multipart", reason, wrong.remedy))
            with suppress(boto.BotoCoreError, boto.ClientError):
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


PATIENCE_S = 1.0
STALL_S = 3.0
REFUSED_SKEW_S = 900.0
"""S3 servers refuse requests from then on."""

SLOW_MB_S = 1.0
SLOW_ROUND_TRIP_MS = 300.0
NO_UPLOADS = "not-defined"

_CLOCK = "Set the clock, as with `sudo timedatectl set-ntp true`."


def examine_bucket(settings: Settings, end_s: float) -> Iterator[Finding]:
    """The bucket of the model, until a monotonic time; starts the embedded server if needed."""
    storage = settings.storage
    bucket = open_bucket(storage, patience_s=PATIENCE_S, read_timeout_s=STALL_S)
    prefix = settings.model_prefix
    folders = [keys.folder(prefix), keys.run_folder(prefix), keys.rollouts_folder(prefix)]
    folders += [keys.folder(settings.custom_files_prefix), keys.folder(settings.metrics_prefix)]
    yield from _examine("bucket", bucket, outermost(folders), _where(storage), end_s)
    try:
        owner = lease.live_holder(ModelStore(bucket, prefix))
    except StorageError:
        return
    if owner is not None:
        text = f"{prefix} is being trained by {owner.owner}"
        yield Finding("bucket", "ok", text, facts={"trained_by": owner.owner})


def examine_upload_bucket(settings: Settings, end_s: float) -> Iterator[Finding]:
    if settings.upload_s3_bucket in ("", NO_UPLOADS):
        return
    bucket = open_upload_bucket(settings.transfer.upload, patience_s=PATIENCE_S)
    folders = [keys.folder(settings.upload_s3_prefix)]
    yield from _examine("upload bucket", bucket, folders, "DR_UPLOAD_S3_BUCKET", end_s)


def examine_minio_folder(settings: Settings) -> Iterator[Finding]:
    with suppress(StorageError):  # told of the bucket itself
        bucket = open_bucket(settings.storage, patience_s=PATIENCE_S)
        for each in review_minio_folder(settings, bucket):
            yield Finding("MinIO", "warning", each.message, each.remedy)


def outermost(folders: Iterable[str]) -> list[str]:
    """Folders that are not inside another one."""
    each = list(dict.fromkeys(folders))
    return [one for one in each if not any(one != o and one.startswith(o) for o in each)]


def _examine(
    subject: str, bucket: S3Bucket, folders: list[str], name: str, end_s: float
) -> Iterator[Finding]:
    trial = try_bucket(bucket, folders, seconds=end_s - time.monotonic())
    yield _speed(subject, bucket, trial, name)
    yield from _permissions(subject, bucket, trial, folders)
    yield from _clock(subject, trial)


def _speed(subject: str, bucket: S3Bucket, trial: Trial, name: str) -> Finding:
    parts = [f"s3://{bucket.name} at {bucket.endpoint.place}"]
    if trial.round_trip_ms is not None:
        parts.append(f"answers in {trial.round_trip_ms:.3g} ms")
    if trial.write_mb_s is not None:
        parts.append(f"writes {trial.write_mb_s:.3g} MB/s")
    if trial.read_mb_s is not None:
        parts.append(f"reads {trial.read_mb_s:.3g} MB/s")
    text = ", ".join(parts)
    facts = {
        "name": bucket.name,
        "address": bucket.endpoint.place,
        "round_trip_ms": trial.round_trip_ms,
        "write_mb_s": trial.write_mb_s,
        "read_mb_s": trial.read_mb_s,
        "conditional_writes": trial.conditional,
    }
    if trial.wrong:
        remedy = f"Use another S3 server ({name}); this one could lose a model."
        return Finding(subject, "problem", f"{text}: {trial.wrong}.", remedy, facts)
    slow = trial.write_mb_s is not None and trial.write_mb_s < SLOW_MB_S
    far = trial.round_trip_ms is not None and trial.round_trip_ms > SLOW_ROUND_TRIP_MS
    if slow or far:
        text += "; each iteration exchanges megabytes in dozens of requests, so this slows it."
        return Finding(subject, "warning", text, f"Use a nearer bucket ({name}).", facts)
    if trial.late:
        text += "; not everything could be tried in time."
        remedy = "Run it again; if this stays, the server or the network is slow."
        return Finding(subject, "warning", text, remedy, facts)
    return Finding(subject, "ok", text, facts=facts)


def _permissions(
    subject: str, bucket: S3Bucket, trial: Trial, folders: list[str]
) -> Iterator[Finding]:
    tried = [folder.rstrip("/") for folder in trial.worked]
    facts = {
        "folders": folders,
        "refused": [{"folder": each.folder, "action": each.action} for each in trial.refused],
        "left": trial.left,
    }

    def cause(each: Refused) -> tuple[str, str]:
        return each.reason, each.action

    for (reason, action), group in groupby(sorted(trial.refused, key=cause), cause):
        refused = list(group)
        where = " and ".join(each.folder for each in refused)
        text = f"{_PHRASES[action].format(where=where)}: {reason}."
        yield Finding(subject, "problem", text, refused[0].remedy, facts)
    if trial.left:
        text = f"test objects could not be deleted: {', '.join(trial.left)}."
        remedy = "Delete them with keys that may; no tool takes them for a model."
        yield Finding(subject, "warning", text, remedy, facts)
    if tried and not trial.refused:
        where = tried[0] if len(tried) == 1 else f"all {len(tried)} folders"
        text = f"write, read, overwrite, list, delete and multipart work in {where}"
        yield Finding(subject, "ok", text, facts=facts)


_PHRASES = {
    "write": "objects cannot be written to {where}",
    "read": "objects cannot be read in {where}",
    "overwrite": "objects cannot be overwritten in {where}",
    "list": "objects cannot be listed in {where}",
    "delete": "objects cannot be deleted in {where}",
    "multipart": "objects above 64 MiB cannot be written in {where}",
}


def _clock(subject: str, trial: Trial) -> Iterator[Finding]:
    ahead_s = trial.clock_ahead_s
    if ahead_s is None:
        return
    facts = {"ahead_s": ahead_s}
    side = "ahead of" if ahead_s > 0 else "behind"
    if abs(ahead_s) > LARGEST_SKEW_S:
        minutes = abs(ahead_s) / 60
        text = f"the clock of this machine is {minutes:.0f} minutes {side} the server's"
        refused = abs(ahead_s) > REFUSED_SKEW_S
        text += "." if refused else "; servers refuse requests from 15 minutes on."
        yield Finding(subject, "problem" if refused else "warning", text, _CLOCK, facts)
    elif abs(ahead_s) < 1.0:
        yield Finding(subject, "ok", "its clock agrees with that of this machine", facts=facts)
    else:
        text = f"the clock of this machine is {abs(ahead_s):.0f} s {side} the server's"
        yield Finding(subject, "ok", text, facts=facts)


def _where(storage: StorageConfig) -> str:
    return "DR_REMOTE_MINIO_URL" if storage.cloud in ("remote", "azure") else "DR_CLOUD"

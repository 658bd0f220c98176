"""Examines a bucket: answers, speed, clock and permissions."""

import time
from collections.abc import Iterable, Iterator
from itertools import groupby

from drcli.base.errors import StorageError
from drcli.checks.doctor.findings import Finding
from drcli.checks.storage_rules import LARGEST_SKEW_S
from drcli.config.bucket_config import StorageConfig
from drcli.config.settings import Settings
from drcli.store import keys, lease
from drcli.store.bucket_trial import Refused, Trial, try_bucket
from drcli.store.connect import open_bucket, open_upload_bucket
from drcli.store.s3_bucket import S3Bucket

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
        owner = lease.live_holder(bucket, prefix)
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

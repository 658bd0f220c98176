"""Imports a model into DeepRacer on AWS."""

import hashlib
import io
import uuid
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Annotated, Any

from drcli.base import errors as notices
from drcli.base.clock import Waiting
from drcli.base.errors import DrError, ProblemsError, SettingsError, StorageError, of_severity
from drcli.base.installation import lazy_imports
from drcli.base.report import counted, size_text
from drcli.bucket.s3_errors import error_code
from drcli.convert.droa_rules import check_description, check_name, package_problems
from drcli.outside.droa.droa_api import Droa, RemoteModel, text_at
from drcli.outside.droa.droa_package import is_wanted
from drcli.outside.droa.droa_session import DroaSession, aws_client, aws_failure
from drcli.outside.web_request import polls

with lazy_imports():
    from boto3 import exceptions as boto3_exceptions
    from boto3.s3 import transfer as s3_transfer
    from botocore import exceptions as boto
    from s3transfer import subscribers

# Copies models to the bucket from which DeepRacer on AWS imports.


FOLDER = "uploads/models"
"""Source: deepracer-on-aws."""

_REFUSED = ("AccessDenied", "403", "AllAccessDisabled", "InvalidAccessKeyId", "ExpiredToken")

_TYPES = {
    ".json": "application/json",
    ".yaml": "application/x-yaml",
    ".yml": "application/x-yaml",
    ".py": "text/x-python",
    ".csv": "text/csv",
    ".txt": "text/plain",
}
Watch = Callable[[int], None]


def upload_files(session: DroaSession, files: Mapping[str, bytes], watch: Watch) -> str:
    """Copy files to a new folder, which is returned.

    The smallest goes first, to prove that writing is allowed. A failure deletes what was sent, if
    possible.

    Raises:
        StorageError: The bucket cannot be written.
    """
    folder = f"{FOLDER}/{uuid.uuid4()}"
    bucket = session.site.upload_bucket
    client = aws_client("s3", session.site, session.keys())
    wanted = [name for name in files if is_wanted(name)]
    sent: list[str] = []
    try:
        for name in sorted(wanted, key=lambda name: len(files[name])):
            sent.append(name)
            _put(client, bucket, f"{folder}/{name}", files[name], watch)
    except (
        boto.BotoCoreError,
        boto.ClientError,
        boto3_exceptions.S3UploadFailedError,
        ValueError,
    ) as e:
        remove_files(session, folder, sent)
        raise _failure(e, name, len(sent) == 1, session) from e
    except BaseException:
        remove_files(session, folder, sent)
        raise
    return folder


def remove_files(session: DroaSession, folder: str, names: list[str]) -> None:
    with suppress(Exception):
        client = aws_client("s3", session.site, session.keys())
        for name in names:
            client.delete_object(Bucket=session.site.upload_bucket, Key=f"{folder}/{name}")


def _put(client: Any, bucket: str, key: str, data: bytes, watch: Watch) -> None:
    class Progress(subscribers.BaseSubscriber):
        def on_progress(self, future: Any, bytes_transferred: int, **_: Any) -> None:
            watch(bytes_transferred)

    kind = _TYPES.get(PurePosixPath(key).suffix.casefold(), "application/octet-stream")
    with s3_transfer.create_transfer_manager(
        client, s3_transfer.TransferConfig(max_concurrency=4)
    ) as transfers:
        transfers.upload(
            io.BytesIO(data), bucket, key, {"ContentType": kind}, [Progress()]
        ).result()


def _failure(error: Exception, name: str, first: bool, session: DroaSession) -> StorageError:
    site = session.site
    where = f"s3://{site.upload_bucket}/{FOLDER}/"
    cause = error.__cause__ or error.__context__
    code = error_code(error) or (error_code(cause) if isinstance(cause, Exception) else "")
    if code in _REFUSED:
        return StorageError(
            f"{session.username} may not write to {where} ({code}).",
            remedy="Run `droa-login` again; if that does not help, ask who runs that site whether "
            "your account may import models.",
        )
    if code == "NoSuchBucket":
        return StorageError(
            f"The upload bucket '{site.upload_bucket}' of {site.place} does not exist.",
            remedy="Check uploadBucketName in env.js of that site, or --upload-bucket.",
        )
    action = f"upload {name} to {where}"
    failure = aws_failure(error, action, site)
    if first:
        return failure
    return StorageError(f"{failure} Nothing was imported.", remedy=failure.remedy)


POLL_S = 5.0
IMPORT_PATIENCE_S = 1800.0
"""The server's check may take 15 minutes."""

Progress = Callable[[str, int], AbstractContextManager[Watch]]


@dataclass(frozen=True)
class ImportPlan:
    """Passed the checks."""

    name: str
    description: str
    files: Mapping[str, bytes]


@dataclass(frozen=True)
class ImportReport:
    """The result of `droa-import-model`."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    model_id: Annotated[str, "Id of the new model; empty after -d."]
    name: Annotated[str, "Its name."]
    status: Annotated[str, "READY, or IMPORTING if nobody waited; empty after -d."]
    files: Annotated[int, "How many files were uploaded."]
    uploaded_bytes: Annotated[int, "Their size."]
    folder: Annotated[str, "Where they are in the upload bucket; empty after -d."]
    dry_run: Annotated[bool, "Whether -d was given, so that nothing was sent."] = False
    existed: Annotated[
        bool, "Whether the same import was there already, so that nothing was sent (--once)."
    ] = False

    def __str__(self) -> str:
        size = f"{counted(self.files, 'file')}, {size_text(self.uploaded_bytes)}"
        if self.dry_run:
            return f"Would import {self.name} into {self.site}: {size}."
        if self.existed:
            return f"{self.name} was imported into {self.site} before, as {self.model_id}."
        state = "It is ready." if self.status == "READY" else "It is being checked there."
        return f"Imported {self.name} into {self.site} as {self.model_id}: {size}. {state}"


class ImportFailed(SettingsError):
    """DeepRacer on AWS has refused the model."""


def plan_import(
    files: Mapping[str, bytes], name: str, description: str = "", *, unchecked: bool = False
) -> ImportPlan:
    """Check a model before anything is sent, and show warnings.

    `unchecked` makes errors in files warnings.

    Raises:
        SettingsError: DeepRacer on AWS would refuse it.
    """
    check_name(name)
    check_description(description)
    wanted = {each: data for each, data in files.items() if is_wanted(each)}
    found = package_problems(wanted)
    for each in of_severity(found, "warning"):
        notices.warn(str(each))
    errors = of_severity(found, "error")
    if errors and not unchecked:
        raise ProblemsError(errors)
    for each in errors:
        notices.warn(f"{each} This does not keep it from being imported, because of --unchecked.")
    return ImportPlan(name, description, wanted)


def planned_report(site: str, plan: ImportPlan) -> ImportReport:
    size = sum(map(len, plan.files.values()))
    return ImportReport(site, "", plan.name, "", len(plan.files), size, "", dry_run=True)


def fingerprint_of(files: Mapping[str, bytes]) -> str:
    whole = hashlib.sha256()
    for name in sorted(files):
        if ".ckpt" in name or name.endswith(".pb"):
            whole.update(f"{name}\0{len(files[name])}\0".encode())
            whole.update(files[name])
    return whole.hexdigest()[:16]


def find_import(droa: Droa, plan: ImportPlan) -> ImportReport | None:
    """An earlier one with the same name and description."""
    for listed in droa.models():
        if listed.name != plan.name or listed.status in ("ERROR", "DELETING"):
            continue
        model = droa.model(listed.model_id)
        if text_at(model.values, "description") == plan.description:
            return ImportReport(
                droa.place, model.model_id, plan.name, model.status, 0, 0, "", existed=True
            )
    return None


def import_files(
    droa: Droa,
    plan: ImportPlan,
    *,
    progress: Progress,
    waiting: Waiting | None = None,
) -> ImportReport:
    """Import a model; `waiting` None: do not wait.

    Raises:
        ImportFailed: The server refused it.
        StorageError: It failed, or took too long.
    """
    size = sum(map(len, plan.files.values()))
    with progress("Uploading model", size) as watch:
        folder = upload_files(droa.session, plan.files, watch)
    try:
        model_id = droa.import_model(folder, plan.name, plan.description)
    except DrError:
        remove_files(droa.session, folder, list(plan.files))
        raise
    report = ImportReport(
        droa.place, model_id, plan.name, "IMPORTING", len(plan.files), size, folder
    )
    if waiting is None:
        return report
    with waiting(f"{droa.place} checks the model {model_id} ..."):
        model = wait_for_import(droa, model_id)
    return replace(report, status=model.status)


def wait_for_import(droa: Droa, model_id: str) -> RemoteModel:
    """Wait until a model is imported.

    Raises:
        ImportFailed: The server refused it.
        StorageError: A call failed, or it took too long.
    """
    later = f"Ask again with `droa-get-model {model_id}`."
    for _ in polls(POLL_S, IMPORT_PATIENCE_S, droa.pause):
        model = droa.model(model_id)
        if model.status == "READY":
            return model
        if model.status == "ERROR":
            reason = " ".join((model.import_error or "no reason given").split()).rstrip(".")
            raise ImportFailed(
                f"{droa.place} refused the model {model.name} ({model_id}): {reason}.",
                remedy=f"Correct the model and import it again; `droa-delete-model {model_id}` "
                "removes this one.",
            )
        if model.status == "DELETING":
            raise StorageError(
                f"The model {model.name} ({model_id}) is being deleted while it is imported.",
                remedy="Import it again.",
            )
    raise StorageError(
        f"{droa.place} is still busy with the model {model_id} after "
        f"{IMPORT_PATIENCE_S / 60:g} minutes.",
        remedy=later,
    )

"""Copies models to the bucket from which DeepRacer on AWS imports."""

import io
import uuid
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import PurePosixPath
from typing import Any

from drcli.base.errors import StorageError
from drcli.remote.droa_aws import aws_client, aws_failure
from drcli.remote.droa_package import is_wanted
from drcli.remote.droa_session import DroaSession
from drcli.store.s3_errors import error_code

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
    from boto3.exceptions import S3UploadFailedError
    from botocore.exceptions import BotoCoreError, ClientError

    folder = f"{FOLDER}/{uuid.uuid4()}"
    bucket = session.site.upload_bucket
    client = aws_client("s3", session.site, session.keys())
    wanted = [name for name in files if is_wanted(name)]
    sent: list[str] = []
    try:
        for name in sorted(wanted, key=lambda name: len(files[name])):
            sent.append(name)
            _put(client, bucket, f"{folder}/{name}", files[name], watch)
    except (BotoCoreError, ClientError, S3UploadFailedError, ValueError) as e:
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
    from boto3.s3.transfer import TransferConfig, create_transfer_manager
    from s3transfer.subscribers import BaseSubscriber

    class Progress(BaseSubscriber):
        def on_progress(self, future: Any, bytes_transferred: int, **_: Any) -> None:
            watch(bytes_transferred)

    kind = _TYPES.get(PurePosixPath(key).suffix.casefold(), "application/octet-stream")
    with create_transfer_manager(client, TransferConfig(max_concurrency=4)) as transfers:
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

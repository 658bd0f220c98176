"""Explains botocore's exceptions: a sentence, a remedy, and whether to try again."""

import shutil
from dataclasses import dataclass

from drcli.base.errors import DiskFull, NoAnswer, StorageError
from drcli.store.bucket import ObjectMissing
from drcli.store.endpoint import Endpoint

MISSING_CODES = frozenset({"NoSuchKey", "404"})
_REFUSED_CODES = frozenset(
    {
        "403",
        "AccessDenied",
        "AuthorizationHeaderMalformed",
        "ExpiredToken",
        "InvalidAccessKeyId",
        "InvalidToken",
        "SignatureDoesNotMatch",
    }
)
_BUSY_CODES = frozenset({"SlowDown", "503", "ServiceUnavailable", "RequestTimeout", "Throttling"})
_FULL_CODES = frozenset({"507", "XMinioStorageFull", "QuotaExceeded", "InsufficientStorage"})

_SPARE_BYTES = 1_000_000
"""A disk with less space than this besides the object counts as full."""


@dataclass(frozen=True)
class Attempt:
    """A request, for the text of an error.

    Args:
        action: A verb, such as `write`.
        endpoint: The server.
        bucket: Name of the bucket.
        key: Of the object; empty for the bucket.
        size_bytes: Bytes to be written.
    """

    action: str
    endpoint: Endpoint
    bucket: str
    key: str = ""
    size_bytes: int = 0

    def __str__(self) -> str:
        what = f"{self.bucket}/{self.key}" if self.key else f"bucket '{self.bucket}'"
        return f"{self.action} {what} at {self.endpoint.place}"


def patience_share(error: Exception) -> float:
    """For which part of the patience a call is repeated: all (1), a little (0.1) or none (0).

    A server that is silent or busy may be starting again. One with an internal error may be
    overwriting the object; rclone then fails for a moment.
    """
    from botocore import exceptions as boto

    if isinstance(error, boto.ClientError):
        code, status = _answer(error)
        if code in _FULL_CODES or status == 507:
            return 0.0
        if code in _BUSY_CODES or status == 503:
            return 1.0
        return 0.1 if status >= 500 else 0.0
    broken = (boto.ConnectionError, boto.HTTPClientError, boto.IncompleteReadError, ConnectionError)
    return 1.0 if isinstance(error, broken) else 0.0


def explain(error: Exception, attempt: Attempt) -> StorageError:
    """Turn an exception of boto3 into the error that the user reads."""
    from botocore.exceptions import ClientError, NoCredentialsError, PartialCredentialsError

    if isinstance(error, ClientError):
        return _explain_answer(error, attempt)
    if isinstance(error, (NoCredentialsError, PartialCredentialsError)):
        return StorageError(
            f"Cannot {attempt}: boto3 found no access keys ({attempt.endpoint.names.profile} is "
            f"'{attempt.endpoint.profile or ''}').",
            remedy=f"Set {attempt.endpoint.names.profile} to a profile of ~/.aws/credentials, or "
            "export AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY.",
        )
    if patience_share(error) == 0:
        return StorageError(f"Cannot {attempt}: {error}.", remedy="Check the storage settings.")
    endpoint = attempt.endpoint
    if endpoint.engine is not None:
        remedy = "Start the command again; it starts the local server if that is not running."
    elif endpoint.url is None:
        remedy = "Check the network connection and DR_AWS_APP_REGION."
    else:
        remedy = f"Start that server, or correct {endpoint.names.address}."
    return NoAnswer(
        f"Cannot {attempt} ({endpoint.setting}): no server answers there.", remedy=remedy
    )


def _explain_answer(error: Exception, attempt: Attempt) -> StorageError:
    code, status = _answer(error)
    endpoint = attempt.endpoint
    names = endpoint.names
    if code == "NoSuchBucket" or (code in MISSING_CODES and not attempt.key):
        return StorageError(
            f"The bucket '{attempt.bucket}' does not exist at {endpoint.place} ({names.bucket}).",
            remedy=f"Correct {names.bucket}, or create the bucket.",
        )
    if code == "InvalidBucketName":
        return StorageError(
            f"The server at {endpoint.place} does not accept '{attempt.bucket}' as a bucket name "
            f"({names.bucket}).",
            remedy=f"Set {names.bucket} to 3 to 63 lowercase letters, digits, dots and hyphens.",
        )
    if code in MISSING_CODES:
        return ObjectMissing(
            f"The object {attempt.bucket}/{attempt.key} does not exist at {endpoint.place}.",
            remedy=f"Check the model prefix ({names.prefix}) and the bucket ({names.bucket}).",
        )
    if code in _REFUSED_CODES or status == 403:
        whose = names.profile if endpoint.engine is None else endpoint.setting
        return StorageError(
            f"Cannot {attempt}: the server refuses the access keys of {whose} ({code}).",
            remedy="Check the keys of that profile, and that they are allowed to read, "
            f"write, list and delete in '{attempt.bucket}'."
            if endpoint.engine is None
            else f"Another server uses {endpoint.url}; set DR_LOCAL_S3_PORT to a free port.",
        )
    if code in _FULL_CODES or status == 507 or (status >= 500 and _disk_is_full(attempt)):
        where = f" under {endpoint.data_dir}" if endpoint.data_dir else ""
        return DiskFull(
            f"Cannot {attempt}: the disk{where} is full.",
            remedy="Make room, for example by deleting old models, then continue the run.",
        )
    return StorageError(
        f"Cannot {attempt}: the server answered {status} {code}.",
        remedy=f"Look at {endpoint.data_dir / '.server.log'}."
        if endpoint.engine is not None and endpoint.data_dir is not None
        else "Try again; if it fails again, ask the person who runs that server.",
    )


def _answer(error: Exception) -> tuple[str, int]:
    """Error code and HTTP status of a ClientError; 0 without a status."""
    response = getattr(error, "response", {})
    code = str(response.get("Error", {}).get("Code", ""))
    return code, int(response.get("ResponseMetadata", {}).get("HTTPStatusCode", 0))


def _disk_is_full(attempt: Attempt) -> bool:
    """Whether the object does not fit on the disk of the local server."""
    data_dir = attempt.endpoint.data_dir
    if data_dir is None or not data_dir.exists():
        return False
    return shutil.disk_usage(data_dir).free < attempt.size_bytes + _SPARE_BYTES

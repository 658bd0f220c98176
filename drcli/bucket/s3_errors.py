"""Explains botocore's exceptions: a sentence, a remedy, and whether to repeat."""

import re
import shutil
import time
from collections.abc import Iterable
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from typing import Any

from drcli.base.errors import DiskFull, NoAnswer, NoKeys, StorageError
from drcli.base.installation import lazy_imports
from drcli.bucket.bucket import TEST_FOLDER, ObjectMissing
from drcli.bucket.endpoint import Endpoint, SettingNames

with lazy_imports():
    from botocore import exceptions as boto
    from botocore import parsers as botocore_parsers

MISSING_CODES = frozenset({"NoSuchKey", "404"})
_KEY_CODES = frozenset(
    {
        "AuthorizationHeaderMalformed",
        "InvalidAccessKeyId",
        "InvalidToken",
        "SignatureDoesNotMatch",
    }
)
_EXPIRED_CODES = frozenset({"ExpiredToken", "ExpiredTokenException", "TokenRefreshRequired"})
"""Of sessions, roles and single sign-on."""

_DENIED_CODES = frozenset({"AccessDenied", "AllAccessDisabled", "AccessDeniedException"})
_CLOCK_CODES = frozenset({"RequestTimeTooSkewed", "RequestExpired"})
_MOST_SKEW_S = 14.5 * 60.0
"""Servers accept 15 minutes."""

_REGION_CODES = frozenset(
    {"PermanentRedirect", "IllegalLocationConstraintException", "TemporaryRedirect"}
)
_READ_ONLY_CODES = frozenset({"405", "MethodNotAllowed", "501", "NotImplemented"})
_PERMISSIONS = {
    "write": "s3:PutObject",
    "read": "s3:GetObject",
    "look up": "s3:GetObject",
    "delete": "s3:DeleteObject",
    "create": "s3:CreateBucket",
}
_DENIED_ACTION = re.compile(
    r"not authorized to perform: ([a-z0-9-]+:[A-Za-z]+)(?: on resource: \"?(arn:[^\s\"]+))?"
)
"""Source: Amazon's page on access denied messages."""

_EXPLICIT = {
    "resource-based policy": "the policy of the bucket",
    "service control policy": "a service control policy of the organization",
    "permissions boundary": "a permissions boundary",
    "identity-based policy": "the policy of these keys",
}
_BUSY_CODES = frozenset({"SlowDown", "ServiceUnavailable", "RequestTimeout", "Throttling"})
_BLOCKED_CODES = frozenset({"XMinioParentIsObject", "ExistingObjectIsFile", "ObjectParentIsFile"})
"""An object where a folder must be: MinIO, SeaweedFS, VersityGW. rclone: 500."""

_FULL_CODES = frozenset({"XMinioStorageFull", "QuotaExceeded", "InsufficientStorage"})

_FRESH_KEYS = (
    "Check the keys of that profile: sign in again, as with `aws sso login`, or write new ones. "
    "Then run the command again, or continue a training with `dr-start-training --resume`."
)

_SPARE_BYTES = 1_000_000
"""A disk with less counts as full."""


class AccessRefused(StorageError):
    """The access keys are known, but lack a permission.

    `folder` is `arn:aws:s3:::bucket/folder/*`, or empty.
    """

    def __init__(self, message: str, *, remedy: str, reason: str, folder: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.reason = reason
        self._folder = folder

    def below(self, folders: Iterable[str]) -> "AccessRefused":
        """For a trial, with all needed folders (ending with a slash)."""
        if not self._folder:
            return self
        bucket = self._folder.split("/", 1)[0]
        needed = ", ".join(f"{bucket}/{folder}*" for folder in folders)
        remedy = self.remedy.replace(self._folder, needed)
        return AccessRefused(str(self), remedy=remedy, reason=self.reason, folder=needed)


@dataclass(frozen=True)
class Attempt:
    """`action` is a verb such as `write`; `key` is empty for the bucket."""

    action: str
    endpoint: Endpoint
    bucket: str
    key: str = ""
    size_bytes: int = 0

    def __str__(self) -> str:
        what = f"{self.bucket}/{self.key}" if self.key else f"bucket '{self.bucket}'"
        return f"{self.action} {what} at {self.endpoint.place}"


def patience_share(error: Exception, *, ours: bool, unattended: bool = False) -> float:
    """For which part of the patience a call is repeated: 1, 0.1 or 0.

    A silent or busy server may be restarting. Ours (`ours`), with an internal error, may be
    overwriting the object, when rclone fails for a moment; what lasts is a full disk. Others'
    internal errors pass. `unattended` also waits for the clock and for access keys, which may come
    late at boot.
    """
    if isinstance(error, boto.NoCredentialsError):
        return float(unattended)
    if isinstance(error, boto.ClientError):
        code, status = _answer(error)
        if _is_of_clock(error):
            return float(unattended)
        if code in _FULL_CODES or status == 507:
            return 0.0
        if code in _BUSY_CODES or status == 503:
            return 1.0
        if status >= 500:
            return 0.1 if ours else 1.0
        return 0.0
    broken = (boto.ConnectionError, boto.HTTPClientError, boto.IncompleteReadError, ConnectionError)
    return 1.0 if isinstance(error, (*broken, botocore_parsers.ResponseParserError)) else 0.0


def local_trouble(error: Exception, endpoint: Endpoint) -> str:
    """What to say if this machine is to blame: its clock, or missing keys; else empty."""
    if isinstance(error, boto.NoCredentialsError):
        return (
            f"boto3 finds no access keys for {endpoint.place} ({endpoint.names.profile} is "
            f"'{endpoint.profile or ''}'). Waiting for them, as the service that has them may be "
            "busy ..."
        )
    if not _is_of_clock(error):
        return ""
    return (
        f"{endpoint.place} refuses all requests until the clock of this machine is set, as with "
        f"`sudo timedatectl set-ntp true`: it differs too much from the server's "
        f"({error_code(error)})."
    )


def hides_its_code(error: Exception) -> bool:
    """Whether a HEAD's reason needs the body of a GET."""
    return _answer(error)[1] in (400, 401, 403)


def passes(code: str) -> bool:
    return code in _BUSY_CODES | {"InternalError"}


def needs_folder(error: BaseException | None) -> bool:
    if not isinstance(error, Exception):
        return False
    code, status = _answer(error)
    return code in _BLOCKED_CODES or status >= 500


def blocked(attempt: Attempt, above: str, size_bytes: int) -> StorageError:
    endpoint, place = attempt.endpoint, f"s3://{attempt.bucket}/{above}"
    own = endpoint.names.bucket == SettingNames.bucket
    program = "dr-local-aws" if own else f"aws --endpoint-url {endpoint.place}"
    return StorageError(
        f"Cannot {attempt}: the object {attempt.bucket}/{above} ({size_bytes} bytes) is where that "
        "server needs a folder.",
        remedy=f"Delete it if nobody needs it, as with `{program} s3 rm {place}`; some programs "
        "write an empty object for a folder.",
    )


def explain(error: Exception, attempt: Attempt) -> StorageError:
    if isinstance(error, boto.ClientError):
        return _explain_answer(error, attempt)
    if isinstance(error, (boto.NoCredentialsError, boto.PartialCredentialsError)):
        return NoKeys(
            f"Cannot {attempt}: boto3 found no access keys ({attempt.endpoint.names.profile} is "
            f"'{attempt.endpoint.profile or ''}').",
            remedy=f"Set {attempt.endpoint.names.profile} to a profile of ~/.aws/credentials, or "
            "export AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY.",
        )
    if isinstance(error, (boto.CredentialRetrievalError, boto.SSOError, boto.TokenRetrievalError)):
        return StorageError(
            f"Cannot {attempt}: boto3 cannot get the access keys of "
            f"{attempt.endpoint.names.profile}: {str(error).rstrip('.')}.",
            remedy=_FRESH_KEYS,
        )
    if patience_share(error, ours=attempt.endpoint.engine is not None) == 0:
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


def explain_entry(code: str, said: str, attempt: Attempt) -> StorageError:
    """For one object of a success, such as a deletion."""
    if attempt.endpoint.engine is None and (code in _DENIED_CODES or code.startswith("KMS.")):
        return _explain_denial(code, " ".join(said.split()), attempt)
    return StorageError(
        f"Cannot {attempt}: the server answered {code} {said}.",
        remedy="Check that the access keys have permission to do so.",
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
    if (region := _other_region(error)) is not None:
        where = f"another region, {region}" if region else "another region"
        return StorageError(
            f"Cannot {attempt}: the bucket is in {where} ({code}).",
            remedy=f"Set the region in the profile of {names.profile} in ~/.aws/config, or with "
            "DR_AWS_APP_REGION.",
        )
    if _is_of_clock(error):
        return StorageError(
            f"Cannot {attempt}: the clocks of this machine and of the server differ ({code}).",
            remedy="Set the clock, as with `sudo timedatectl set-ntp true`.",
        )
    if endpoint.engine is None and (code in _DENIED_CODES or code.startswith("KMS.")):
        return _explain_denial(code, _said(error), attempt)
    if code in _EXPIRED_CODES:
        return StorageError(
            f"Cannot {attempt}: the server refuses the access keys of {names.profile}, which have "
            f"expired ({code}).",
            remedy=_FRESH_KEYS,
        )
    if code in _READ_ONLY_CODES and attempt.action in ("write", "delete"):
        return StorageError(
            f"Cannot {attempt}: the server allows no changes there ({status} {code}).",
            remedy=f"Choose another bucket with {names.bucket}, or ask the person who runs that "
            "server whether it is read-only.",
        )
    if code in _KEY_CODES | _DENIED_CODES or status == 403:
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


def _explain_denial(code: str, said: str, attempt: Attempt) -> AccessRefused:
    found = _DENIED_ACTION.search(said)
    permission = found[1] if found else _PERMISSIONS.get(attempt.action, "s3:ListBucket")
    names, bucket = attempt.endpoint.names, f"arn:aws:s3:::{attempt.bucket}"
    # A policy that allows the folder of a trial alone would be of no use.
    folder = attempt.key.partition(TEST_FOLDER)[0].rpartition("/")[0]
    inside = f"{bucket}/{folder}/*".replace("//", "/")
    place = bucket if permission in ("s3:ListBucket", "s3:CreateBucket") else inside
    if permission.startswith("kms:"):
        place = found[2] if found and found[2] else "the KMS key of the bucket"
    who_asks = f"the access keys of {names.profile}"
    remedy = (
        f"Add {permission} on {place} to the policy of these keys, or choose other keys with "
        f"{names.profile}."
    )
    if code.startswith("KMS."):
        reason = f"the KMS key of the bucket cannot be used ({code}{said and f': {said}'})"
        remedy = "Enable that key, or choose another encryption for the bucket."
        return AccessRefused(f"Cannot {attempt}: {reason}.", remedy=remedy, reason=reason)
    who = next((who for words, who in _EXPLICIT.items() if words in said), "a policy")
    if "explicit deny" in said:
        reason = f"{who} denies {permission} to {who_asks} ({code})"
        remedy = (
            f"Ask the owner of '{attempt.bucket}' to remove what denies {permission} on {place}, "
            f"or choose another bucket with {names.bucket}."
        )
    else:
        reason = f"{who_asks} lack the permission {permission} ({code})"
    return AccessRefused(
        f"Cannot {attempt}: {reason}.",
        remedy=remedy,
        reason=reason,
        folder=inside if place == inside else "",
    )


def _is_of_clock(error: Exception) -> bool:
    """Whether this machine's clock is to blame.

    By the answer's time, as rclone and others call it AccessDenied (status 400) if behind.
    """
    code, status = _answer(error)
    if code in _CLOCK_CODES or status not in (400, 403):
        return code in _CLOCK_CODES
    headers = _response(error).get("ResponseMetadata", {}).get("HTTPHeaders", {})
    try:
        now = parsedate_to_datetime(headers["date"])
    except (KeyError, ValueError):
        return False
    return abs(time.time() - now.timestamp()) > _MOST_SKEW_S


def _other_region(error: Exception) -> str | None:
    code, status = _answer(error)
    malformed = code == "AuthorizationHeaderMalformed" and "region" in _said(error)
    if code not in _REGION_CODES and status != 301 and not malformed:
        return None
    response = _response(error)
    headers = response.get("ResponseMetadata", {}).get("HTTPHeaders", {})
    expected = re.search(r"expecting '([a-z0-9-]+)'", _said(error))
    named = response.get("Error", {}).get("Region") or headers.get("x-amz-bucket-region")
    return str(named or (expected[1] if expected else ""))


def _response(error: Exception) -> dict[str, Any]:
    found = getattr(error, "response", None)
    return found if isinstance(found, dict) else {}  # lost connections have a `response`, too: None


def _said(error: Exception) -> str:
    text = _response(error).get("Error", {}).get("Message") or ""
    return " ".join(str(text).split())


def error_code(error: Exception) -> str:
    return str(_response(error).get("Error", {}).get("Code", ""))


def error_text(error: Exception) -> str:
    return (_said(error) or " ".join(str(error).split())).rstrip(".")


def _answer(error: Exception) -> tuple[str, int]:
    metadata = _response(error).get("ResponseMetadata", {})
    return error_code(error), int(metadata.get("HTTPStatusCode", 0))


def _disk_is_full(attempt: Attempt) -> bool:
    data_dir = attempt.endpoint.data_dir
    if data_dir is None or not data_dir.exists():
        return False
    return shutil.disk_usage(data_dir).free < attempt.size_bytes + _SPARE_BYTES

"""Proves that a bucket can be written, before anything changes."""

from contextlib import suppress

from drcli.base import errors
from drcli.base.errors import StorageError
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.bucket.s3_errors import AccessRefused
from drcli.model import keys
from drcli.model.model_store import ModelStore

NAME = ".drcli-write-test.txt"
"""Of the test object.

Always the same, so only one stays where deleting fails. No importer takes it for a model's.
"""

_CONTENT = b"Written by drcli to test whether uploads are possible. It can be deleted.\n"


def prove_writing(model: ModelStore, *, deletes: bool) -> None:
    """Write, read and delete a test object, before anything else below a prefix.

    Objects that cannot be deleted are a warning, unless the caller `deletes`.

    Raises:
        AccessRefused: A permission is missing.
        StorageError: The server refuses or alters objects for another reason.
    """
    key = keys.folder(model.prefix) + NAME
    place = model.url
    try:
        model.bucket.put(key, _CONTENT)
    except AccessRefused as e:
        raise _unchanged(place, "write to", e) from e
    try:
        _read_back(model.bucket, key, place)
    except AccessRefused as e:
        with suppress(StorageError):
            model.bucket.delete([key])
        raise _unchanged(place, "read what it writes to", e) from e
    except BaseException:
        with suppress(StorageError):
            model.bucket.delete([key])
        raise
    try:
        model.bucket.delete([key])
    except AccessRefused as e:
        if deletes:
            raise AccessRefused(
                f"drcli cannot delete objects below {place}: {e.reason}; the test object {NAME} "
                "stays there, and nothing else was changed.",
                remedy=e.remedy,
                reason=e.reason,
            ) from e
        errors.warn(
            f"Objects below {place} cannot be deleted: {e.reason}. Writing works, but the test "
            f"object {NAME} stays there, and -w would fail."
        )


def _read_back(bucket: Bucket, key: str, place: str) -> None:
    try:
        content = bucket.get(key)
    except ObjectMissing:
        return  # another upload to this prefix has just deleted it
    if content != _CONTENT:
        raise StorageError(
            f"The server returned other data than was written below {place}.",
            remedy="Use another S3 server; this one would lose a model.",
        )


def _unchanged(place: str, action: str, error: AccessRefused) -> AccessRefused:
    return AccessRefused(
        f"drcli cannot {action} {place}: {error.reason}; nothing there was changed.",
        remedy=error.remedy,
        reason=error.reason,
    )

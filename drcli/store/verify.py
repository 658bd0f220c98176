"""Checks that an object in a bucket is complete and unchanged, without reading it if possible."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from drcli.base.fingerprint import Fingerprint
from drcli.store.bucket import Bucket, ObjectInfo, ObjectMissing
from drcli.store.s3_bucket import PART_BYTES

MD5_DIGITS = 32
"""A shorter ETag, such as those of the embedded server, only tells that the object has changed."""


@dataclass(frozen=True)
class Checksums:
    """Checksums of an object.

    Args:
        fingerprint: Size and hash.
        etags: Those that servers compute: the MD5 of an object that was sent in one piece, and the
            MD5 of the MD5 of its parts.
    """

    fingerprint: Fingerprint
    etags: Sequence[str]

    @classmethod
    def of(cls, data: bytes) -> "Checksums":
        """Compute the checksums of these bytes."""
        parts = [data[start : start + PART_BYTES] for start in range(0, len(data), PART_BYTES)]
        joined = b"".join(_md5(part).digest() for part in parts)
        return cls(
            Fingerprint.of(data),
            (_md5(data).hexdigest(), f"{_md5(joined).hexdigest()}-{len(parts)}"),
        )

    def matches(self, bucket: Bucket, info: ObjectInfo | None) -> bool:
        """Whether an object has these bytes: it is read unless its etag in the listing is right."""
        if info is None or info.size_bytes != self.fingerprint.size_bytes:
            return False
        if info.etag in self.etags:
            return True
        try:
            return self.fingerprint.fault(bucket.get(info.key)) is None
        except ObjectMissing:
            return False


def _md5(data: bytes) -> "hashlib._Hash":
    """Not for security, so that machines which forbid MD5 allow it."""
    return hashlib.md5(data, usedforsecurity=False)

"""Checks that an object in a bucket is what was sent, without reading it where possible."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from drcli.base.fingerprint import Fingerprint
from drcli.store.bucket import Bucket, ObjectInfo, ObjectMissing
from drcli.store.s3_bucket import PART_BYTES


@dataclass(frozen=True)
class Checksums:
    """What tells whether an object is these bytes.

    Args:
        fingerprint: Size and hash.
        etags: What servers call an object of these bytes that was sent by us: its MD5 when it
            came in one piece, the MD5 of its parts' otherwise.
    """

    fingerprint: Fingerprint
    etags: Sequence[str]

    @classmethod
    def of(cls, data: bytes) -> "Checksums":
        """Checksums of these bytes."""
        parts = [data[start : start + PART_BYTES] for start in range(0, len(data), PART_BYTES)]
        joined = b"".join(_md5(part).digest() for part in parts)
        return cls(
            Fingerprint.of(data),
            (_md5(data).hexdigest(), f"{_md5(joined).hexdigest()}-{len(parts)}"),
        )

    def matches(self, bucket: Bucket, info: ObjectInfo | None) -> bool:
        """Whether an object is these bytes.

        The server's word is taken where its listing has the right etag. An encrypted object, or
        one of a server without etags, is read.
        """
        if info is None or info.size_bytes != self.fingerprint.size_bytes:
            return False
        if info.etag in self.etags:
            return True
        try:
            return self.fingerprint.fault(bucket.get(info.key)) is None
        except ObjectMissing:
            return False


def _md5(data: bytes) -> "hashlib._Hash":
    """For comparison alone; machines that forbid MD5 for safety allow that."""
    return hashlib.md5(data, usedforsecurity=False)

"""Checks that an object is complete and unchanged, if possible unread."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from drcli.base.json_record import Fingerprint
from drcli.bucket.bucket import Bucket, ObjectInfo, ObjectMissing
from drcli.bucket.s3_bucket import PART_BYTES

MD5_DIGITS = 32


@dataclass(frozen=True)
class Checksums:
    """`etags` are MD5, and MD5 of the parts' MD5."""

    fingerprint: Fingerprint
    etags: Sequence[str]

    @classmethod
    def of(cls, data: bytes) -> "Checksums":
        parts = [data[start : start + PART_BYTES] for start in range(0, len(data), PART_BYTES)]
        joined = b"".join(_md5(part).digest() for part in parts)
        return cls(
            Fingerprint.of(data),
            (_md5(data).hexdigest(), f"{_md5(joined).hexdigest()}-{len(parts)}"),
        )

    def matches(self, bucket: Bucket, info: ObjectInfo | None) -> bool:
        """Reads it unless its etag is right."""
        if info is None or info.size_bytes != self.fingerprint.size_bytes:
            return False
        if info.etag in self.etags:
            return True
        try:
            return self.fingerprint.fault(bucket.get(info.key)) is None
        except ObjectMissing:
            return False


def _md5(data: bytes) -> "hashlib._Hash":
    """Not for security: allowed where MD5 is forbidden."""
    return hashlib.md5(data, usedforsecurity=False)

"""Size and hash show whether an object is complete and unchanged."""

import hashlib
from dataclasses import dataclass


@dataclass(frozen=True)
class Fingerprint:
    """SHA-256, because `sha256sum` checks it as well; 23 MB take about 15 ms."""

    size_bytes: int
    sha256: str

    @classmethod
    def of(cls, data: bytes) -> "Fingerprint":
        return cls(len(data), hashlib.sha256(data).hexdigest())

    def fault(self, data: bytes) -> str | None:
        """None if unchanged."""
        if len(data) != self.size_bytes:
            return f"{len(data)} bytes instead of {self.size_bytes}"
        if hashlib.sha256(data).hexdigest() != self.sha256:
            return "its SHA-256 differs from the recorded one"
        return None

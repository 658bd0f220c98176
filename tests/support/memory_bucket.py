"""A bucket that lives in memory, for tests of everything that stands on one."""

import copy
import threading
import time
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from typing import Self

from drcli.bucket.bucket import (
    Listing,
    ObjectInfo,
    ObjectMissing,
    Watch,
    checked_folder,
    without_placeholders,
)


class MemoryBucket:
    """Keeps objects in a dictionary and behaves like S3Bucket otherwise.

    Args:
        name: Of the bucket.
        clock: Unix seconds of its server.
    """

    def __init__(self, name: str = "bucket", *, clock: Callable[[], float] = time.time) -> None:
        self.name = name
        self._clock = clock
        self._before_write: Callable[[str], None] = lambda key: None
        self._objects: dict[str, tuple[bytes, datetime]] = {}
        self._lock = threading.Lock()

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """Read a whole object; ObjectMissing when there is none."""
        with self._lock:
            if key not in self._objects:
                raise ObjectMissing(
                    f"The object {self.name}/{key} does not exist in memory.",
                    remedy="Write it before reading it.",
                )
            data = self._objects[key][0]
        if watch is not None:
            watch(len(data))
        return data

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """Read a whole object, and how many seconds ago it was written by the server's clock."""
        data = MemoryBucket.get(self, key)
        with self._lock:
            modified = self._objects[key][1]
        return data, self._clock() - modified.timestamp()

    def fenced(self, check: Callable[[str], None]) -> Self:
        """The same bucket, which calls `check` with every key that it is to write or delete."""
        fenced = copy.copy(self)
        fenced._before_write = check
        return fenced

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """Keep a copy of the data."""
        self._before_write(key)
        with self._lock:
            self._objects[key] = (bytes(data), datetime.fromtimestamp(self._clock(), UTC))
        if watch is not None:
            watch(len(data))

    def delete(self, keys: Iterable[str]) -> None:
        """Forget objects."""
        doomed = list(keys)
        for key in doomed:
            self._before_write(key)
        with self._lock:
            for key in doomed:
                self._objects.pop(key, None)

    def exists(self, key: str) -> bool:
        """Whether there is an object under this key."""
        with self._lock:
            return key in self._objects

    def list(self, folder: str) -> Listing:
        """All objects below a folder (which ends with a slash), sorted by key."""
        start = checked_folder(folder)
        with self._lock:
            found = {k: v for k, v in self._objects.items() if k.startswith(start)}
        return without_placeholders(
            # Python computes the hash of some bytes once; SHA-256 would be computed each time.
            ObjectInfo(key, len(data), f"{hash(data) % 2**64:016x}", modified)
            for key, (data, modified) in found.items()
        )

"""Reads records of races anew only when a listing shows a change.

Pages look every second; without changes this costs one request.
"""

import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

from drcli.store.bucket import Bucket, Listing, ObjectInfo, ObjectMissing, Watch

_Version = tuple[str, int, datetime]


@dataclass(frozen=True)
class _Kept:
    """`version` was listed before reading, so it is never newer than the data."""

    version: _Version
    data: bytes
    age_s: float | None
    read_s: float


class RaceObjects:
    """Thread-safe memory of one bucket's races."""

    def __init__(self) -> None:
        self._kept: dict[str, _Kept] = {}
        self._lock = threading.Lock()

    def look(self, bucket: Bucket, folder: str) -> "SeenBucket":
        """The objects below a folder now, in a bucket that stays the same.

        Raises:
            StorageError: The bucket does not answer.
        """
        listed = {info.key: info for info in bucket.list(folder)}
        with self._lock:
            for key in [key for key in self._kept if key.startswith(folder)]:
                if key not in listed:
                    del self._kept[key]
        return SeenBucket(self, bucket, folder, listed)

    def kept(self, info: ObjectInfo) -> _Kept | None:
        with self._lock:
            found = self._kept.get(info.key)
        return found if found is not None and found.version == _version(info) else None

    def keep(self, info: ObjectInfo, data: bytes, age_s: float | None) -> None:
        with self._lock:
            self._kept[info.key] = _Kept(_version(info), data, age_s, time.monotonic())


class SeenBucket:
    """One look at a folder; a `Bucket` for reading."""

    def __init__(
        self, objects: RaceObjects, bucket: Bucket, folder: str, listed: dict[str, ObjectInfo]
    ) -> None:
        self.name = bucket.name
        self._objects, self._bucket = objects, bucket
        self._folder, self._listed = folder, listed
        self._given: set[str] = set()

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """From memory if unchanged.

        A second `get` in one look means damage, see `bucket.read_record`: then it is read anew.
        """
        found = self._known(key) if watch is None else None
        return self._read(key)[0] if found is None else found.data

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        found = self._known(key)
        if found is None:
            return self._read(key)
        passed_s = time.monotonic() - found.read_s
        return found.data, None if found.age_s is None else found.age_s + passed_s

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """This look does not show it."""
        self._bucket.put(key, data, watch=watch)

    def delete(self, keys: Iterable[str]) -> None:
        """This look still shows it."""
        self._bucket.delete(keys)

    def exists(self, key: str) -> bool:
        return key in self._listed if key.startswith(self._folder) else self._bucket.exists(key)

    def list(self, folder: str) -> Listing:
        if not folder.startswith(self._folder):
            return self._bucket.list(folder)
        return [info for key, info in self._listed.items() if key.startswith(folder)]

    def _known(self, key: str) -> _Kept | None:
        info = self._listed.get(key)
        if info is None:
            if key.startswith(self._folder):
                raise ObjectMissing(f"{self.name}/{key} does not exist.", remedy="Check the name.")
            return None
        if key in self._given:
            return None
        self._given.add(key)
        return self._objects.kept(info)

    def _read(self, key: str) -> tuple[bytes, float | None]:
        data, age_s = self._bucket.get_with_age(key)
        info = self._listed.get(key)
        if info is not None:
            self._objects.keep(info, data, age_s)
        return data, age_s


def _version(info: ObjectInfo) -> _Version:
    return info.etag, info.size_bytes, info.modified

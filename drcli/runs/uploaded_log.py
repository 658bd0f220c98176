"""Reads the copy of another machine's log in the bucket."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from drcli.exchange.log_places import log_kind
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectInfo, ObjectMissing

_KNOWN_BYTES = 4 << 10


@dataclass(frozen=True)
class UploadedLog:
    """As `run_logs.LogCopy` writes it."""

    bucket: Bucket
    key: str
    objects: tuple[ObjectInfo, ...]

    @property
    def uploaded(self) -> datetime:
        return max(info.modified for info in self.objects)

    def pieces(self, since: datetime | None = None) -> Iterator[bytes]:
        """Without objects that have only lines from before `since`."""
        return self._read([each for each in self.objects if since is None or each.modified > since])

    def last_lines(self, count: int) -> bytes:
        found = b""
        for piece in self._read(self.objects[::-1]):
            found = piece + found
            if found.count(b"\n") > count:
                break
        return b"".join(found.splitlines(keepends=True)[-count:]) if count else b""

    def _read(self, objects: Sequence[ObjectInfo]) -> Iterator[bytes]:
        for info in objects:
            try:
                yield self.bucket.get(info.key)
            except ObjectMissing:  # a log that has become too large loses its oldest parts
                continue


class UploadedTail:
    def __init__(self, bucket: Bucket, key: str, shown: bytes) -> None:
        self._bucket = bucket
        self._key = key
        self._shown = shown[-_KNOWN_BYTES:]
        self._objects: tuple[ObjectInfo, ...] = ()

    def read(self) -> bytes:
        """The whole log if it was begun anew."""
        found = find_objects(self._bucket, self._key)
        if found is None or found.objects == self._objects:
            return b""
        text = b""
        for info in reversed(found.objects):
            text = b"".join(UploadedLog(self._bucket, self._key, (info,)).pieces()) + text
            place = text.rfind(self._shown) if self._shown else -1
            if place >= 0:
                text = text[place + len(self._shown) :]
                break
        self._objects = found.objects
        self._shown = (self._shown + text)[-_KNOWN_BYTES:]
        return text


def find_uploaded(bucket: Bucket, prefix: str, name: str, file: str) -> UploadedLog | None:
    return find_objects(bucket, keys.log(prefix, log_kind(name), file))


def find_objects(bucket: Bucket, key: str) -> UploadedLog | None:
    newest, parts = [], []
    for info in bucket.list(key.rpartition("/")[0] + "/"):
        number = keys.part_number(key, info.key)
        if number is not None:
            parts.append((number, info))
        elif info.key == key:
            newest.append(info)
    objects = [info for _, info in sorted(parts, key=lambda part: part[0])] + newest
    return UploadedLog(bucket, key, tuple(objects)) if objects else None

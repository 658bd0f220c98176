"""Reads the copy of a log that the machine which writes it has put into the bucket."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from drcli.exchange.log_places import log_kind
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectInfo, ObjectMissing

_KNOWN_BYTES = 4 << 10
"""So many bytes are enough to find a place in a log again: its lines have times."""


@dataclass(frozen=True)
class UploadedLog:
    """The copy of a log, as `run_logs.LogCopy` writes it: parts, and an object with the rest.

    Attributes:
        bucket: Where it is.
        key: Of the object with the newest lines.
        objects: Those that exist, the oldest lines first.
    """

    bucket: Bucket
    key: str
    objects: tuple[ObjectInfo, ...]

    @property
    def uploaded(self) -> datetime:
        """When lines were uploaded for the last time."""
        return max(info.modified for info in self.objects)

    def pieces(self, since: datetime | None = None) -> Iterator[bytes]:
        """The log, object by object; without objects that have only lines from before `since`."""
        return self._read([each for each in self.objects if since is None or each.modified > since])

    def last_lines(self, count: int) -> bytes:
        """The last lines, from as few objects as possible."""
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
    """What is added to the copy of a log.

    Args:
        bucket: Where it is.
        key: Of the object with the newest lines.
        shown: The log up to here, or its last lines.
    """

    def __init__(self, bucket: Bucket, key: str, shown: bytes) -> None:
        self._bucket = bucket
        self._key = key
        self._shown = shown[-_KNOWN_BYTES:]
        self._objects: tuple[ObjectInfo, ...] = ()

    def read(self) -> bytes:
        """New lines; the whole log if it was begun anew.

        Raises:
            StorageError: The bucket does not answer.
        """
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
    """The copy of a log in the bucket; None if there is none.

    Args:
        bucket: Where to look; one listing.
        prefix: Of the model.
        name: Of the log, such as "sim-0" or "reward-0".
        file: Name of the log file on the machine that wrote it.

    Raises:
        StorageError: The bucket does not answer.
    """
    return find_objects(bucket, keys.log(prefix, log_kind(name), file))


def find_objects(bucket: Bucket, key: str) -> UploadedLog | None:
    """The same by the key of the object with the newest lines."""
    newest, parts = [], []
    for info in bucket.list(key.rpartition("/")[0] + "/"):
        number = keys.part_number(key, info.key)
        if number is not None:
            parts.append((number, info))
        elif info.key == key:
            newest.append(info)
    objects = [info for _, info in sorted(parts, key=lambda part: part[0])] + newest
    return UploadedLog(bucket, key, tuple(objects)) if objects else None

"""The interface of a bucket: on any S3 server, in a folder, or in the memory of a test."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol, TypeVar

from drcli.base.errors import StorageError
from drcli.base.json_record import NewerFormat, RecordError

TEST_FOLDER = ".drcli-test"
"""Beginning of the names of test objects and their folders; no tool takes them for a model."""


class ObjectMissing(StorageError):
    """No object has this key."""


class ObjectDamaged(StorageError):
    """The object exists, but is damaged."""


class ObjectNewer(StorageError):
    """A newer version of drcli has written the object; this one leaves it alone."""

    final = True


@dataclass(frozen=True)
class ObjectInfo:
    """One line of a listing.

    `etag` changes with the content. It need not be an MD5, and is empty where there is no server.
    """

    key: str
    size_bytes: int
    etag: str
    modified: datetime


Watch = Callable[[int], None]
"""Called with the number of bytes transferred since the last call; negative after a failure."""

T = TypeVar("T")

Listing = list[ObjectInfo]
"""Has a name because `list` is a method of a bucket."""


class Bucket(Protocol):
    """Objects by key. Every method may raise StorageError."""

    name: str
    """Of the bucket."""

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """Read a whole object; ObjectMissing if it does not exist."""

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """Read a whole object and its age; ObjectMissing if it does not exist.

        The age is in seconds by the server's clock, None if the server does not return it.
        """

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """Write an object, which readers see completely or not at all. May be repeated."""

    def delete(self, keys: Iterable[str]) -> None:
        """Delete objects, which need not exist."""

    def exists(self, key: str) -> bool:
        """Whether an object with this key exists."""

    def list(self, folder: str) -> Listing:
        """All objects below a folder, which ends with a slash or is empty, sorted by key.

        Placeholders of folders are left out, see `without_placeholders`.
        """


READS, READS_FAR = 2, 16
"""Objects that are read at the same time from a bucket on this machine, whose server needs the
processor, and from one elsewhere, where each read waits for a round trip. By the model of
docs/scale.md, 100 workers are three times as fast so as with one read after the other."""

_OVERWRITTEN_S = (0.005, 0.03)
"""Pauses before an object is read again that looked damaged or missing."""


def read_record(
    bucket: Bucket,
    key: str,
    decode: Callable[[bytes], T],
    remedy: str,
    *,
    written: bool = False,
    pause: Callable[[float], None] = time.sleep,
) -> T:
    """Read an object and decode it.

    While an object is overwritten, the embedded server may answer with the new content cut to the
    length of the old one, or that there is no such object (1 in 200 reads beside a client that
    writes all the time, rclone 1.75). So what looks damaged is read again.

    Args:
        bucket: Where it is.
        key: Of the object.
        decode: Raises RecordError if the object is damaged.
        remedy: What to do about a damaged object.
        written: It is known to exist, so it is read again also if it looks missing.
        pause: Waits for so many seconds.

    Raises:
        ObjectMissing: It does not exist.
        ObjectNewer: `decode` has raised NewerFormat.
        ObjectDamaged: `decode` has raised another RecordError; the remedy is that of the error.
    """
    for pause_s in _OVERWRITTEN_S:
        try:
            return _decoded(bucket, key, decode, remedy)
        except ObjectDamaged:
            pause(pause_s)
        except ObjectMissing:
            if not written:
                raise
            pause(pause_s)
    return _decoded(bucket, key, decode, remedy)


def _decoded(bucket: Bucket, key: str, decode: Callable[[bytes], T], remedy: str) -> T:
    data = bucket.get(key)
    try:
        return decode(data)
    except NewerFormat as e:
        raise ObjectNewer(
            f"{bucket.name}/{key} was written by a newer version of drcli: {e}.",
            remedy="Update drcli on this machine.",
        ) from e
    except RecordError as e:
        raise ObjectDamaged(f"{bucket.name}/{key} is damaged: {e}.", remedy=remedy) from e


_PLACEHOLDERS = ("_$folder$", "/.keep", "/.gitkeep", "/.bzEmpty", "/.emptyFolderPlaceholder")
"""Ends of keys of empty objects that stand for a folder: Hadoop writes the first, Backblaze and
Supabase the last two."""


def without_placeholders(listed: Iterable[ObjectInfo]) -> Listing:
    """The objects without those that other programs write for a folder, sorted by key.

    S3 browsers write `model/`, which some servers list as an empty object `model` beside what is
    below `model/`. A copy of either would be a file where a folder must be.
    """
    objects = [info for info in listed if not info.key.endswith("/")]
    empty = {info.key for info in objects if not info.size_bytes}
    if empty:
        marks = {key for key in empty if f"/{key}".endswith(_PLACEHOLDERS)}
        for info in objects:
            marks |= empty.intersection(keys_above(info.key))
        objects = [info for info in objects if info.key not in marks]
    return sorted(objects, key=lambda info: info.key)


def keys_above(key: str) -> Iterator[str]:
    """The keys of objects that are where some servers need a folder for an object."""
    for end, character in enumerate(key):
        if character == "/":
            yield key[:end]


def checked_folder(folder: str) -> str:
    """The folder itself; `model-1` without a slash would also list `model-10`."""
    if folder and not folder.endswith("/"):
        raise ValueError(f"List folders only, with a slash at the end: {folder!r}.")
    return folder

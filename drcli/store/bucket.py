"""The bucket as the rest of the program sees it: a few verbs, on any S3 server or in memory."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol, TypeVar

from drcli.base.errors import StorageError
from drcli.base.json_record import RecordError


class ObjectMissing(StorageError):
    """No object has this key."""


class ObjectDamaged(StorageError):
    """The object exists, but it is not what was written."""


@dataclass(frozen=True)
class ObjectInfo:
    """One line of a listing.

    The embedded server leaves `etag` empty: it would have to read every object to fill it.
    """

    key: str
    size_bytes: int
    etag: str
    modified: datetime


Watch = Callable[[int], None]
"""Takes how many more bytes were transferred; negative when they must be sent again."""

T = TypeVar("T")

Listing = list[ObjectInfo]
"""Named, because inside a bucket `list` is a verb."""


class Bucket(Protocol):
    """What the rest of the program needs from it. Every method may raise StorageError."""

    @property
    def name(self) -> str:
        """Name of the bucket."""

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """Read a whole object; ObjectMissing when there is none."""

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """Read a whole object, and how long ago it was written.

        Returns:
            The object, and seconds by the clock of the server alone, whatever the clock of this
            machine says; None where the server does not tell.

        Raises:
            ObjectMissing: There is none.
        """

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """Write an object, which other readers see whole or not at all. May be repeated."""

    def delete(self, keys: Iterable[str]) -> None:
        """Delete objects; it is not an error if one does not exist."""

    def exists(self, key: str) -> bool:
        """Whether there is an object under this key."""

    def list(self, folder: str) -> Listing:
        """All objects below a folder, sorted by key.

        Args:
            folder: Ends with a slash, so that `model-1/` does not list `model-10/`; empty for all.
        """


def read_record(bucket: Bucket, key: str, decode: Callable[[bytes], T], remedy: str) -> T:
    """Read an object and decode it.

    Args:
        bucket: Holds it.
        key: The object.
        decode: Makes a record of the bytes; RecordError where it cannot.
        remedy: What to do where it cannot.

    Raises:
        ObjectMissing: There is no such object.
        ObjectDamaged: It is something else.
    """
    data = bucket.get(key)
    try:
        return decode(data)
    except RecordError as e:
        raise ObjectDamaged(f"{bucket.name}/{key} is damaged: {e}.", remedy=remedy) from e


def checked_folder(folder: str) -> str:
    """The folder itself; a listing without the closing slash would mix in its neighbours."""
    if folder and not folder.endswith("/"):
        raise ValueError(f"List folders only, with a slash at the end: {folder!r}.")
    return folder

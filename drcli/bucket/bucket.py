"""The interface of a bucket: S3, folder, or a test's memory."""

import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
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
    """A newer drcli wrote it; this one leaves it alone."""

    final = True


@dataclass(frozen=True)
class ObjectInfo:
    """`etag` changes with the content, need not be an MD5, and is empty without a server."""

    key: str
    size_bytes: int
    etag: str
    modified: datetime


Watch = Callable[[int], None]
"""Takes the bytes since the last call; negative after a failure."""

T = TypeVar("T")

Listing = list[ObjectInfo]


class Bucket(Protocol):
    """Every method may raise StorageError."""

    name: str

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """ObjectMissing if it does not exist."""

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """As `get`, with the age in seconds by the server's clock, or None."""

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """Readers see all or nothing. May be repeated."""

    def delete(self, keys: Iterable[str]) -> None:
        """Keys need not exist."""

    def exists(self, key: str) -> bool:
        """Whether there is such an object."""

    def list(self, folder: str) -> Listing:
        """Sorted by key, without placeholders; the folder ends with a slash or is empty."""


READS, READS_FAR = 2, 16
"""Objects that are read at the same time from a bucket on this machine, whose server needs the
processor, and from one elsewhere, where each read waits for a round trip. By the model of
docs/scale.md, 100 workers are three times as fast so as with one read after the other."""

_OVERWRITTEN_S = (0.005, 0.03)


def read_record(
    bucket: Bucket,
    key: str,
    decode: Callable[[bytes], T],
    *,
    written: bool = False,
    pause: Callable[[float], None] = time.sleep,
) -> T:
    """Read an object and decode it.

    While an object is overwritten, the embedded server may answer with new content cut to the old
    length, or that there is none (1 in 200 reads beside a constant writer, rclone 1.75). So what
    looks damaged, or missing although `written`, is read again.

    Raises:
        ObjectMissing: It does not exist.
        ObjectNewer: `decode` raised NewerFormat.
        ObjectDamaged: `decode` raised another RecordError.
    """
    for pause_s in _OVERWRITTEN_S:
        try:
            return _decoded(bucket, key, decode)
        except ObjectDamaged:
            pause(pause_s)
        except ObjectMissing:
            if not written:
                raise
            pause(pause_s)
    return _decoded(bucket, key, decode)


def find_record(bucket: Bucket, key: str, decode: Callable[[bytes], T]) -> T | None:
    """As `read_record`; None if it does not exist."""
    try:
        return read_record(bucket, key, decode)
    except ObjectMissing:
        return None


def readable_record(bucket: Bucket, key: str, decode: Callable[[bytes], T]) -> T | None:
    """None also if it is damaged: for what is soon written again."""
    with suppress(ObjectMissing, RecordError):
        return decode(bucket.get(key))
    return None


def readable_records(bucket: Bucket, folder: str, decode: Callable[[bytes], T]) -> list[T]:
    found = (readable_record(bucket, info.key, decode) for info in bucket.list(folder))
    return [record for record in found if record is not None]


def _decoded(bucket: Bucket, key: str, decode: Callable[[bytes], T]) -> T:
    data = bucket.get(key)
    try:
        return decode(data)
    except NewerFormat as e:
        raise ObjectNewer(
            f"{bucket.name}/{key} was written by a newer version of drcli: {e}.",
            remedy="Update drcli on this machine.",
        ) from e
    except RecordError as e:
        raise ObjectDamaged(f"{bucket.name}/{key} is damaged: {e}.", remedy=remedy_of(key)) from e


_PLACEHOLDERS = ("_$folder$", "/.keep", "/.gitkeep", "/.bzEmpty", "/.emptyFolderPlaceholder")
"""Empty objects for folders: of Hadoop; the last two of Backblaze and Supabase."""


def without_placeholders(listed: Iterable[ObjectInfo]) -> Listing:
    """The objects without those that other programs write for a folder, sorted.

    S3 browsers write `model/`, which some servers list as `model`: a file where a folder must be.
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
    for end, character in enumerate(key):
        if character == "/":
            yield key[:end]


def checked_folder(folder: str) -> str:
    """`model-1` without a slash would also list `model-10`."""
    if folder and not folder.endswith("/"):
        raise ValueError(f"List folders only, with a slash at the end: {folder!r}.")
    return folder


# What to do about a damaged object, by its key.


_RESUME = "Continue with `dr-start-training --resume`, which"
_WRITTEN_AGAIN = "Nothing is to be done: the training writes it again when it continues."

_REMEDIES: tuple[tuple[str, str], ...] = (
    (r"races/.+", "Remove that object, or delete the race with `dr-race delete`."),
    (
        r"sweeps/.+\.json",
        "Delete {key} from the bucket and give the sweep another name; its models stay.",
    ),
    (r"training-records/.+", "Delete it with `dr-history forget`, or restore it from a copy."),
    (r"rollouts/.+", "The worker drives the iteration again."),
    (r"runs/.+/evaluations/\d+\.json", "Delete it; the next checkpoint is evaluated again."),
    (r"runs/.+/outcome\.json", "The next start writes it again."),
    (r"runs/.+/join\.json", "The next start writes it."),
    (r"runs/.+/shares\.json", "The trainer writes it again with the next checkpoint."),
    (r"runs/.+/lease\.json", _WRITTEN_AGAIN),
    (r"runs/.+/(status|members)/.+", _WRITTEN_AGAIN),
    (r".+/model/\.coach_checkpoint", f"{_RESUME} lets it name the newest whole checkpoint again."),
    (
        r".+\.ckpt\.json",
        "Choose another checkpoint; `dr-start-training --resume` continues without it.",
    ),
    (
        r".+\.ckpt\.(optimizer\.)?safetensors",
        "Restore it from a copy, or choose another checkpoint; `dr-start-training --resume` "
        "continues without it.",
    ),
    (
        r".+/history\.json(\.part-\d+)?",
        "Stop the training and continue with `dr-start-training --resume`, which reconstructs it.",
    ),
    (
        r".+/rollbacks\.json",
        "Delete it: then the training goes on with the learning rate of its hyperparameters.",
    ),
    (r".+/ip/run\.json", f"{_RESUME} writes it again."),
    (
        r".+/notes/.+",
        "Write it again with `dr-note edit`, or remove it with `dr-note remove`.",
    ),
    (r".+/(evaluation-\d+\.json|recording\.json)", "Evaluate the model again."),
    (
        r".+/(deepracer_checkpoints|milestones|TrainingMetrics(_\d+)?)\.json(\.part-\d+)?",
        f"{_RESUME} reconstructs it.",
    ),
    (r".*", "Restore it from a copy."),
)


def remedy_of(key: str) -> str:
    found = next(remedy for pattern, remedy in _REMEDIES if re.fullmatch(pattern, key))
    return found.format(key=key)

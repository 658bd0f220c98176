"""An object to which each iteration adds an entry, such as a learning curve, at constant cost.

S3 cannot append. A small object is written anew with each entry. A larger one is written only now
and then, and the entries of the meantime are in parts, `history.json.part-000012` and so on: a
part has the entries of a few iterations in the format of the whole object, which makes it small
enough to be written anew with each of them. The object and its parts together are complete at any
time, and readers combine them; where both have an entry, they had it from the same iteration.
"""

import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from drcli.base.errors import DrError, StorageError
from drcli.base.log import get_logger
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

_logger = get_logger(__name__)

T = TypeVar("T")

SMALL_BYTES = 128 << 10
"""Up to this size, the whole object is written with each entry."""

WHOLE_SHARE = 0.01
"""Share of the time that may go into writing the whole object."""

WHOLE_EVERY_S = 5.0
"""Least time between two writes of the whole object, once it is not small."""

_BETWEEN = b"\0"
"""Separates entries in memory; neither JSON nor CSV contains it."""


@dataclass(frozen=True)
class Layout:
    """The format: `head`, the entries with `separator` between them, `end`."""

    head: bytes
    separator: bytes
    end: bytes

    def text(self, entries: Iterable[bytes]) -> bytes:
        """The content of an object with these entries."""
        return self.head + self.separator.join(entries) + self.end


class GrowingFile:
    """One such object. Only one process writes it, from one thread.

    Args:
        bucket: Where it is.
        key: Of the whole object.
        layout: Its format.
        iterations_per_part: How many.
        clock: Monotonic seconds, for tests.
    """

    def __init__(
        self,
        bucket: Bucket,
        key: str,
        layout: Layout,
        *,
        iterations_per_part: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bucket = bucket
        self._key = key
        self.layout = layout
        self._per_part = iterations_per_part
        self._clock = clock
        # Entries by iteration, in groups of a part. Only the newest groups are not compressed: the
        # memory of a process must hardly grow while it trains for days.
        self._open: dict[int, dict[int, bytes]] = {}
        self._closed: dict[int, tuple[tuple[int, ...], bytes]] = {}
        self._size_bytes = 0
        self._parts: dict[int, int] = {}
        """Parts in the bucket, each with the number of the change that wrote it."""
        self._changes = 0
        self._outdated = False
        self._writer: ThreadPoolExecutor | None = None
        self._writing: Future[float] | None = None
        self._covered: dict[int, int] = {}
        self._next_whole_s = 0.0

    def restore(
        self, entries: Iterable[tuple[int, bytes]], parts: Iterable[str], *, outdated: bool = False
    ) -> None:
        """Continue an object of an earlier process.

        Args:
            entries: By iteration, in order.
            parts: Keys of the parts in the bucket.
            outdated: Whether the object or a part has other entries than these; the whole object
                is written with the next entry then.
        """
        self._fill(entries)
        numbers = (keys.part_number(self._key, part) for part in parts)
        self._parts = {number: 0 for number in numbers if number is not None}
        self._outdated = outdated

    def entry(self, iteration: int) -> bytes | None:
        """The entry of an iteration, None if it has none."""
        group = iteration // self._per_part
        if group not in self._open and group in self._closed:
            return dict(self._unpacked(group)).get(iteration)
        return self._open.get(group, {}).get(iteration)

    def put(self, iteration: int, entry: bytes) -> None:
        """Add or replace an entry, and store it; StorageError if that fails."""
        self._set(iteration, entry)
        self._settle()
        if self._outdated or (self._size_bytes <= SMALL_BYTES and self._writing is None):
            self._write_now()
            return
        group = iteration // self._per_part
        self._bucket.put(keys.part(self._key, group), self._part(group))
        self._changes += 1
        self._parts[group] = self._changes
        if self._writing is None and self._clock() >= self._next_whole_s:
            self._write_later()

    def drop_from(self, iteration: int) -> None:
        """Remove the entries of this iteration and of later ones, in the bucket too.

        Parts change before the whole object. So whenever this is interrupted, only entries that
        were to be dropped are left over, and the next process drops them.
        """
        first = iteration // self._per_part
        doomed = [n for g in self._groups() if g >= first for n, _ in self._unpacked(g)]
        doomed = [n for n in doomed if n >= iteration]
        if not doomed:
            return
        self._wait()
        for number in doomed:
            self._remove(number)
        left = self._groups()
        if first in self._parts and first in left:
            self._bucket.put(keys.part(self._key, first), self._part(first))
        self._delete_parts([group for group in self._parts if group not in left])
        self._outdated = True  # the next entry writes the whole object

    def write(self) -> None:
        """Write the whole object now if it lacks something; StorageError if that fails."""
        self._wait()
        if self._parts or self._outdated:
            self._write_now()

    def finish(self) -> None:
        """Write the whole object for the last time; failures are logged, the parts stay then."""
        try:
            self.write()
        except DrError as error:
            _logger.warning("%s/%s is not complete: %s", self._bucket.name, self._key, error)
        if self._writer is not None:
            self._writer.shutdown()

    def replace(self, layout: Layout, change: Callable[[bytes], bytes]) -> None:
        """Change the format and every entry; the whole object is written with the next entry."""
        self.layout = layout
        self._fill([(n, change(entry)) for n, entry in self._entries()])
        self._outdated = True

    def text(self) -> bytes:
        """The content of the whole object."""
        return self.layout.text(entry for _, entry in self._entries())

    def _entries(self) -> Iterator[tuple[int, bytes]]:
        for group in self._groups():
            yield from self._unpacked(group)

    def _groups(self) -> list[int]:
        return sorted({*self._closed, *self._open})

    def _unpacked(self, group: int) -> list[tuple[int, bytes]]:
        if group in self._open:
            return sorted(self._open[group].items())
        numbers, packed = self._closed[group]
        return list(zip(numbers, zlib.decompress(packed).split(_BETWEEN), strict=True))

    def _part(self, group: int) -> bytes:
        return self.layout.text(entry for _, entry in self._unpacked(group))

    def _fill(self, entries: Iterable[tuple[int, bytes]]) -> None:
        self._open, self._closed, self._size_bytes = {}, {}, 0
        for iteration, entry in entries:
            self._set(iteration, entry)

    def _set(self, iteration: int, entry: bytes) -> None:
        entries = self._opened(iteration // self._per_part)
        self._size_bytes += len(entry) - len(entries.get(iteration, b""))
        entries[iteration] = entry
        while len(self._open) > 2:
            oldest = min(self._open)
            unpacked = self._unpacked(oldest)
            packed = zlib.compress(_BETWEEN.join(entry for _, entry in unpacked), level=1)
            self._closed[oldest] = tuple(number for number, _ in unpacked), packed
            del self._open[oldest]

    def _remove(self, iteration: int) -> None:
        group = iteration // self._per_part
        entries = self._opened(group)
        self._size_bytes -= len(entries.pop(iteration))
        if not entries:
            del self._open[group]

    def _opened(self, group: int) -> dict[int, bytes]:
        if group not in self._open:
            self._open[group] = dict(self._unpacked(group)) if group in self._closed else {}
            self._closed.pop(group, None)
        return self._open[group]

    def _write_now(self) -> None:
        self._wait()
        self._bucket.put(self._key, self.text())
        self._outdated = False
        self._delete_parts(list(self._parts))

    def _write_later(self) -> None:
        """Write the whole object in another thread, from what is known now."""
        self._writer = self._writer or ThreadPoolExecutor(1, thread_name_prefix="whole-file")
        self._covered = dict(self._parts)
        layout, texts = self.layout, [self._snapshot(group) for group in self._groups()]

        def write() -> float:
            began_s = self._clock()
            entries = (entry for text in texts for entry in text())
            self._bucket.put(self._key, layout.text(entries))
            return self._clock() - began_s

        self._writing = self._writer.submit(write)

    def _snapshot(self, group: int) -> Callable[[], list[bytes]]:
        """The entries of a group as they are now, for another thread."""
        if group in self._open:
            entries = [entry for _, entry in self._unpacked(group)]
            return lambda: entries
        packed = self._closed[group][1]
        return lambda: zlib.decompress(packed).split(_BETWEEN)

    def _settle(self) -> None:
        """If the whole object was written meanwhile, delete the parts that it has now."""
        if self._writing is None or not self._writing.done():
            return
        writing, self._writing = self._writing, None
        try:
            took_s = writing.result()
        except StorageError as error:
            _logger.warning(
                "%s/%s was not written; its parts are complete: %s",
                self._bucket.name,
                self._key,
                error,
            )
            self._next_whole_s = self._clock() + WHOLE_EVERY_S
            return
        self._next_whole_s = self._clock() + max(WHOLE_EVERY_S, took_s / WHOLE_SHARE)
        self._delete_parts(
            [g for g, change in self._covered.items() if self._parts.get(g) == change]
        )

    def _wait(self) -> None:
        if self._writing is not None:
            self._writing.exception()  # waits; `_settle` says what was wrong
            self._settle()

    def _delete_parts(self, groups: list[int]) -> None:
        if groups:
            self._bucket.delete([keys.part(self._key, group) for group in groups])
            for group in groups:
                del self._parts[group]


def list_parts(bucket: Bucket, key: str) -> list[str]:
    """Keys of the parts of an object, oldest first."""
    folder = key.rpartition("/")[0] + "/"
    found = [info.key for info in bucket.list(folder)]
    return [part for part in found if keys.part_number(key, part) is not None]


def read_parts(bucket: Bucket, key: str, read: Callable[[str], T]) -> list[T]:
    """What `read` returns for each part of an object, oldest first.

    Read the whole object afterwards: a part that is deleted meanwhile is in it.
    """
    found = []
    for part in list_parts(bucket, key):
        with suppress(ObjectMissing):
            found.append(read(part))
    return found

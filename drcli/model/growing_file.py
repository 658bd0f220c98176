"""An object that grows with each iteration, as a learning curve does, at constant cost.

S3 cannot append. A small object is written anew each time; a larger one only now and then, with
later entries in parts `history.json.part-000012`: a few iterations each, in the same format, small
enough to write anew. Object and parts are complete at any time, and readers combine them.
"""

import csv
import io
import re
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from drcli.base.errors import DrError, StorageError
from drcli.base.json_record import RecordError, decode_json
from drcli.base.log import get_logger
from drcli.bucket.bucket import Bucket, ObjectMissing, read_record
from drcli.model import keys
from drcli.records.episode_metrics import EpisodeMetrics, decode_metrics, encode_metrics
from drcli.records.iteration import IterationRecord, decode_history, encode_history

_logger = get_logger(__name__)

R = TypeVar("R")
T = TypeVar("T")

SMALL_BYTES = 128 << 10
"""Up to this size, it is written whole each time."""

WHOLE_SHARE = 0.01
"""Of the time, at most, for writing the whole object."""

WHOLE_EVERY_S = 5.0
_BETWEEN = b"\0"
"""Neither JSON nor CSV contains it."""


@dataclass(frozen=True)
class Layout:
    head: bytes
    separator: bytes
    end: bytes

    def text(self, entries: Iterable[bytes]) -> bytes:
        return self.head + self.separator.join(entries) + self.end


class GrowingFile:
    """Written by one process, from one thread; `clock` is monotonic."""

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
        """Continue an object of an earlier process, with these parts (keys).

        `outdated`: it has other entries; it is written whole with the next.
        """
        self._fill(entries)
        numbers = (keys.part_number(self._key, part) for part in parts)
        self._parts = {number: 0 for number in numbers if number is not None}
        self._outdated = outdated

    def entry(self, iteration: int) -> bytes | None:
        group = iteration // self._per_part
        if group not in self._open and group in self._closed:
            return dict(self._unpacked(group)).get(iteration)
        return self._open.get(group, {}).get(iteration)

    def put(self, iteration: int, entry: bytes) -> None:
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
        """Remove this iteration's and later entries, in the bucket too.

        Parts first: if interrupted, only dropped entries are left over, for the next process to
        drop.
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
        """Write the whole object if it lacks something; StorageError."""
        self._wait()
        if self._parts or self._outdated:
            self._write_now()

    def finish(self) -> None:
        """Write the whole; on failure, log it and keep the parts."""
        try:
            self.write()
        except DrError as error:
            _logger.warning("%s/%s is not complete: %s", self._bucket.name, self._key, error)
        if self._writer is not None:
            self._writer.shutdown()

    def replace(self, layout: Layout, change: Callable[[bytes], bytes]) -> None:
        """Written with the next entry."""
        self.layout = layout
        self._fill([(n, change(entry)) for n, entry in self._entries()])
        self._outdated = True

    def text(self) -> bytes:
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
        if group in self._open:
            entries = [entry for _, entry in self._unpacked(group)]
            return lambda: entries
        packed = self._closed[group][1]
        return lambda: zlib.decompress(packed).split(_BETWEEN)

    def _settle(self) -> None:
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
    folder = key.rpartition("/")[0] + "/"
    found = [info.key for info in bucket.list(folder)]
    return [part for part in found if keys.part_number(key, part) is not None]


def read_parts(bucket: Bucket, key: str, read: Callable[[str], T]) -> list[T]:
    """Each part, oldest first.

    Read the whole object afterwards: it has a part deleted meanwhile.
    """
    found = []
    for part in list_parts(bucket, key):
        with suppress(ObjectMissing):
            found.append(read(part))
    return found


def read_growing(
    bucket: Bucket,
    key: str,
    decode: Callable[[bytes], list[R]],
    combine: Callable[[Sequence[R], Sequence[Sequence[R]]], list[R]],
) -> list[R]:
    """Empty if missing; raises ObjectDamaged."""

    def read(key: str) -> list[R]:
        return read_record(bucket, key, decode)

    parts = read_parts(bucket, key, read)
    whole: list[R] = []
    with suppress(ObjectMissing):
        whole = read(key)
    return combine(whole, parts) if parts else whole


def read_all_metrics(bucket: Bucket, key: str) -> list[EpisodeMetrics]:
    return read_growing(bucket, key, decode_metrics, combined_metrics)


def write_whole(bucket: Bucket, key: str, data: bytes) -> None:
    parts = list_parts(bucket, key)
    bucket.put(key, data)
    bucket.delete(parts)


# Growing files of a running training, read as if complete.


def read_complete(bucket: Bucket, key: str) -> bytes:
    """With its parts; ObjectMissing without any. Damage is left to others."""
    name = key.rpartition("/")[2]
    combine = next((each for pattern, each in _KINDS if re.fullmatch(pattern, name)), None)
    parts = read_parts(bucket, key, bucket.get) if combine is not None else []
    whole = bucket.get(key)
    if combine is None or not parts:
        return whole
    try:
        return combine(whole, parts)
    except (RecordError, ValueError, csv.Error):
        return whole


def combined_history(
    whole: Sequence[IterationRecord], parts: Sequence[Sequence[IterationRecord]]
) -> list[IterationRecord]:
    known = {record.iteration: record for record in whole}
    for part in parts:
        for record in part:
            before = known.get(record.iteration, record)
            if len(before.evaluation_progress) <= len(record.evaluation_progress):
                known[record.iteration] = record
    return [known[iteration] for iteration in sorted(known)]


def combined_metrics(
    whole: Sequence[EpisodeMetrics], parts: Sequence[Sequence[EpisodeMetrics]]
) -> list[EpisodeMetrics]:
    in_parts: dict[int, list[EpisodeMetrics]] = {}
    for part in parts:
        for record in part:
            in_parts.setdefault(record.iteration or 0, []).append(record)
    counts = Counter(record.iteration for record in whole)
    newer = {n: of_n for n, of_n in in_parts.items() if len(of_n) >= counts[n]}
    records = [record for record in whole if record.iteration not in newer]
    records += [record for of_n in newer.values() for record in of_n]
    return sorted(records, key=lambda record: -1 if record.iteration is None else record.iteration)


def _history(whole: bytes, parts: Sequence[bytes]) -> bytes:
    return encode_history(combined_history(decode_history(whole), list(map(decode_history, parts))))


def _metrics(whole: bytes, parts: Sequence[bytes]) -> bytes:
    records = combined_metrics(decode_metrics(whole), list(map(decode_metrics, parts)))
    metric = decode_json(dict[str, Any], whole).get("best_model_metric", "progress")
    return encode_metrics(records, metric)


def _rows(whole: bytes, parts: Sequence[bytes]) -> bytes:
    found: dict[int, dict[str, str]] = {}
    columns: dict[str, None] = {}
    for data in (whole, *parts):
        reader = csv.DictReader(io.StringIO(data.decode(), newline=""))
        columns |= dict.fromkeys(reader.fieldnames or ())
        found |= {int(next(iter(row.values()))): row for row in reader}
    text = io.StringIO()
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(found[iteration] for iteration in sorted(found))
    return text.getvalue().encode()


_KINDS: tuple[tuple[str, Callable[[bytes, Sequence[bytes]], bytes]], ...] = (
    (r"history\.json", _history),
    (r"learner\.csv", _rows),
    (r"TrainingMetrics.*\.json", _metrics),
)

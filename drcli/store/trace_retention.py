"""Limits the training traces of a model: the older, the fewer stay.

Deleting only the oldest would hide the beginning. So every second older iteration goes, then every
second of the rest, and so on. The newest stay, and iteration 0, by which tools learn the episodes
per iteration.
"""

import math
import re
from dataclasses import dataclass

from drcli.store import keys
from drcli.store.bucket import Bucket

MOST_ITERATIONS = 2000
"""However small: for a new object the server reads the folder again (8 ms per thousand, measured);
tools read all.
"""

NEWEST = 10
"""They may be driven again."""

FREED_SHARE = 0.1
"""Freed at once, so that listings are rare."""

LOOK_EVERY = 100


@dataclass
class Thinned:
    iterations: int
    size_bytes: int
    left: int


class TraceRetention:
    """`max_bytes` is for all workers together; 0 keeps all."""

    def __init__(self, bucket: Bucket, prefix: str, workers: int, max_bytes: int) -> None:
        self._bucket = bucket
        self._folders = [
            keys.training_traces_folder(prefix, worker, workers) for worker in range(workers)
        ]
        self._prefix = prefix
        self._max_bytes = max_bytes
        self._next = 0
        if workers == 1 and bucket.list(keys.training_traces_folder(prefix, 0, 2)):
            self.cover(0)  # others had joined an earlier start

    def cover(self, worker: int) -> None:
        folder = keys.training_traces_folder(self._prefix, worker, 2)
        if folder not in self._folders:
            self._folders.append(folder)
        if worker:
            self.cover(0)  # the traces of the first worker move there

    def apply(self, newest: int) -> Thinned | None:
        """Mostly this only compares two numbers."""
        if not self._max_bytes or newest < self._next:
            return None
        traces = self._traces()
        sizes = {n: sum(size for _, size in of_n) for n, of_n in traces.items()}
        doomed = chosen(sizes, newest, self._max_bytes, MOST_ITERATIONS)
        self._bucket.delete([key for n in doomed for key, _ in traces[n]])
        freed = sum(sizes.pop(n) for n in doomed)
        self._next = newest + self._pause(sizes)
        return Thinned(len(doomed), freed, len(sizes)) if doomed else None

    def delete_after(self, iteration: int) -> int:
        later = [key for n, of_n in self._traces().items() if n > iteration for key, _ in of_n]
        self._bucket.delete(later)
        return len(later)

    def _traces(self) -> dict[int, list[tuple[str, int]]]:
        found: dict[int, list[tuple[str, int]]] = {}
        for folder in self._folders:
            for info in self._bucket.list(folder):
                match = re.fullmatch(r"(\d+)-iteration\.csv", info.key.removeprefix(folder))
                if match is not None:
                    found.setdefault(int(match[1]), []).append((info.key, info.size_bytes))
        return found

    def _pause(self, sizes: dict[int, int]) -> int:
        if not sizes:
            return 1
        mean = max(1.0, sum(sizes.values()) / len(sizes))
        room = min((self._max_bytes - sum(sizes.values())) / mean, MOST_ITERATIONS - len(sizes))
        return max(1, min(LOOK_EVERY, math.floor(room)))


def chosen(sizes: dict[int, int], newest: int, max_bytes: int, most: int) -> list[int]:
    """Until bytes and number fit; in this order."""
    total, count = sum(sizes.values()), len(sizes)
    if total <= max_bytes and count <= most:
        return []
    max_bytes, most = round(max_bytes * (1 - FREED_SHARE)), round(most * (1 - FREED_SHARE))
    protected = {0}
    newest_bytes = 0
    for iteration in sorted(sizes, reverse=True):
        newest_bytes += sizes[iteration]
        few = len(protected) > most / 2 or newest_bytes > max_bytes / 2
        if few and iteration <= newest - NEWEST:
            break
        protected.add(iteration)
    doomed = []
    for iteration in sorted(sizes.keys() - protected, key=lambda n: (_divisor(n), n)):
        if total <= max_bytes and count <= most:
            break
        doomed.append(iteration)
        total -= sizes[iteration]
        count -= 1
    return doomed


def _divisor(iteration: int) -> int:
    """Largest power of two: the larger, the longer it stays."""
    return iteration & -iteration

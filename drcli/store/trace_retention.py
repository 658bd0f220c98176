"""Keeps the training traces of a model within a limit: the older they are, the fewer stay.

Only deleting the oldest would take the beginning of the training from analysis tools. So every
second of the older iterations is deleted first, then every second of those that are left, and so
on. The newest stay, and iteration 0, from which tools learn how many episodes an iteration has.
"""

import math
import re
from dataclasses import dataclass

from drcli.store import keys
from drcli.store.bucket import Bucket

MOST_ITERATIONS = 2000
"""How many iterations keep their traces, however small these are: the embedded server reads the
whole folder again for a new object, 8 ms for a thousand objects (measured), and analysis tools read
every object."""

NEWEST = 10
"""Least number of the newest iterations whose traces stay: they may be driven again."""

FREED_SHARE = 0.1
"""Share of the limit that is freed at once, so that listings are rare."""

LOOK_EVERY = 100
"""Most iterations between two listings."""


@dataclass
class Thinned:
    """What was deleted.

    Attributes:
        iterations: How many lost their traces.
        size_bytes: Size of those.
        left: How many iterations still have traces.
    """

    iterations: int
    size_bytes: int
    left: int


class TraceRetention:
    """Deletes training traces of one model.

    Args:
        bucket: Holds the model.
        prefix: The model.
        workers: How many simulation workers write traces.
        max_bytes: Of the traces of all workers together; 0 keeps all traces.
    """

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
        """Also delete traces of a worker that has joined the training."""
        folder = keys.training_traces_folder(self._prefix, worker, 2)
        if folder not in self._folders:
            self._folders.append(folder)
        if worker:
            self.cover(0)  # the traces of the first worker move there

    def apply(self, newest: int) -> Thinned | None:
        """Delete traces if there are too many; mostly, this only compares two numbers.

        Args:
            newest: Number of the newest iteration.

        Returns:
            What was deleted, or None.
        """
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
        """Delete the traces of later iterations, which were given up, and count them."""
        later = [key for n, of_n in self._traces().items() if n > iteration for key, _ in of_n]
        self._bucket.delete(later)
        return len(later)

    def _traces(self) -> dict[int, list[tuple[str, int]]]:
        """Keys and sizes of the traces by iteration."""
        found: dict[int, list[tuple[str, int]]] = {}
        for folder in self._folders:
            for info in self._bucket.list(folder):
                match = re.fullmatch(r"(\d+)-iteration\.csv", info.key.removeprefix(folder))
                if match is not None:
                    found.setdefault(int(match[1]), []).append((info.key, info.size_bytes))
        return found

    def _pause(self, sizes: dict[int, int]) -> int:
        """After how many iterations the limits may be reached."""
        if not sizes:
            return 1
        mean = max(1.0, sum(sizes.values()) / len(sizes))
        room = min((self._max_bytes - sum(sizes.values())) / mean, MOST_ITERATIONS - len(sizes))
        return max(1, min(LOOK_EVERY, math.floor(room)))


def chosen(sizes: dict[int, int], newest: int, max_bytes: int, most: int) -> list[int]:
    """The iterations whose traces are deleted, so that the rest is within both limits.

    Args:
        sizes: Size of the traces of each iteration, bytes.
        newest: Number of the newest iteration.
        max_bytes: Limit of all of them.
        most: Limit of their number.

    Returns:
        Iterations in the order in which they go; empty as long as no limit is exceeded.
    """
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
    """The largest power of two that divides a number: the larger, the longer its trace stays."""
    return iteration & -iteration

"""All objects of a model, in an order to delete them.

Without those of a model inside it (`team` and `team/1`).
"""

import math
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from drcli.bucket.bucket import ObjectInfo
from drcli.model import keys, race_keys
from drcli.model.model_store import ModelStore

POINTERS = ("model/deepracer_checkpoints.json", "model/.coach_checkpoint")
_MARKS = (*POINTERS, "ip/run.json", "ip/hyperparameters.json", "model/model_metadata.json")
_CHECKPOINT = re.compile(r"(.+)/model/\d+_Step-\d+\.ckpt\..+")

_RUN_MARKS = ("lease.json", "outcome.json")

_METRICS = re.compile(
    r"(TrainingMetrics(_\d+)?\.json(\.part-\d+)?|EvaluationMetrics-\d{14}\.json"
    r"|evaluation/evaluation-\d{14}\.json|robust/robust-\d{14}\.json|best-laps\.json)"
)


@dataclass(frozen=True)
class ModelTraces:
    """Everything that a model has in a bucket.

    Attributes:
        objects: In order of deletion: what makes it a model first, its lease last.
        whole: It has a pointer, so lists show it.
    """

    prefix: str
    objects: tuple[ObjectInfo, ...]
    whole: bool

    @property
    def size_bytes(self) -> int:
        return sum(info.size_bytes for info in self.objects)

    @property
    def first(self) -> tuple[str, ...]:
        return tuple(info.key for info in self.objects if _rank(self.prefix, info.key) == 0)

    @property
    def checkpoints(self) -> int:
        found = {keys.checkpoint_of(self.prefix, info.key) for info in self.objects}
        return len(found - {None})


_NO_MODELS = ("runs/", "rollouts/", keys.training_records_folder(), race_keys.folder())


def models_in(listed: Iterable[ObjectInfo]) -> dict[str, bool]:
    found: dict[str, bool] = {}
    for info in listed:
        key = info.key
        if key.startswith(_NO_MODELS):
            continue
        for mark in _MARKS:
            if key.endswith(f"/{mark}"):
                prefix = key.removesuffix(f"/{mark}")
                found[prefix] = found.get(prefix, False) or mark in POINTERS
        match = _CHECKPOINT.fullmatch(key)
        if match is not None:
            found.setdefault(match[1], False)
    return found


def traces_of(
    model: ModelStore, *, metrics_prefix: str | None = None, spared: Collection[str] = ()
) -> ModelTraces:
    """All of a model; `spared` folders, as the racer's files, never belong to it."""
    listed = list(model.bucket.list(keys.folder(model.prefix)))
    nested = {other for other in models_in(listed) if other != model.prefix}
    runs = list(model.bucket.list(keys.run_folder(model.prefix)))
    for info in runs:
        inner, _, name = info.key.removeprefix("runs/").rpartition("/")
        if name in _RUN_MARKS and inner != model.prefix:
            nested.add(inner)
    rollouts = [
        info
        for info in model.bucket.list(keys.rollouts_folder(model.prefix))
        if keys.rollout_key(model.prefix, info.key) is not None
    ]
    metrics: list[ObjectInfo] = []
    if metrics_prefix is not None and not _inside(metrics_prefix, [model.prefix]):
        folder = keys.folder(metrics_prefix)
        metrics = [
            info
            for info in model.bucket.list(folder)
            if _METRICS.fullmatch(info.key.removeprefix(folder))
        ]
    own = [info for info in listed if not _inside(info.key, [*nested, *spared])]
    records = [info for info in runs if not _inside(info.key.removeprefix("runs/"), nested)]
    everything = {info.key: info for info in (*own, *metrics, *rollouts, *records)}
    ordered = sorted(
        everything.values(), key=lambda info: (_rank(model.prefix, info.key), info.key)
    )
    pointers = {keys.folder(model.prefix) + pointer for pointer in POINTERS}
    return ModelTraces(model.prefix, tuple(ordered), bool(pointers & everything.keys()))


def _rank(prefix: str, key: str) -> int:
    pointers = [keys.folder(prefix) + pointer for pointer in POINTERS]
    if key in pointers or key.endswith((".ckpt.json", ".ckpt.index")):
        return 0
    if key == keys.lease(prefix):
        return 3
    # The record of the start says in which folder the metrics are, so it outlasts them.
    late = key == keys.training_start(prefix) or key.startswith(keys.run_folder(prefix))
    return 2 if late else 1


def _inside(key: str, folders: Iterable[str]) -> bool:
    return any(keys.folder(key).startswith(keys.folder(folder)) for folder in folders)


# Limits the training traces of a model: the older, the fewer stay.
#
# Deleting only the oldest would hide the beginning. So every second older iteration goes, then
# every second of the rest, and so on. The newest stay, and iteration 0, by which tools learn the
# episodes per iteration.


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

    def __init__(self, model: ModelStore, workers: int, max_bytes: int) -> None:
        self._model = model
        self._folders = [
            keys.training_traces_folder(model.prefix, worker, workers) for worker in range(workers)
        ]
        self._max_bytes = max_bytes
        self._next = 0
        if workers == 1 and model.bucket.list(keys.training_traces_folder(model.prefix, 0, 2)):
            self.cover(0)  # others had joined an earlier start

    def cover(self, worker: int) -> None:
        folder = keys.training_traces_folder(self._model.prefix, worker, 2)
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
        self._model.bucket.delete([key for n in doomed for key, _ in traces[n]])
        freed = sum(sizes.pop(n) for n in doomed)
        self._next = newest + self._pause(sizes)
        return Thinned(len(doomed), freed, len(sizes)) if doomed else None

    def delete_after(self, iteration: int) -> int:
        later = [key for n, of_n in self._traces().items() if n > iteration for key, _ in of_n]
        self._model.bucket.delete(later)
        return len(later)

    def _traces(self) -> dict[int, list[tuple[str, int]]]:
        found: dict[int, list[tuple[str, int]]] = {}
        for folder in self._folders:
            for info in self._model.bucket.list(folder):
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

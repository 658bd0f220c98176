"""All objects of a model, in an order to delete them.

Without those of a model inside it (`team` and `team/1`).
"""

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from drcli.store import keys, race_keys
from drcli.store.bucket import Bucket, ObjectInfo

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
    bucket: Bucket, prefix: str, *, metrics_prefix: str | None = None, spared: Collection[str] = ()
) -> ModelTraces:
    """All of a model; `spared` folders, as the racer's files, never belong to it."""
    listed = list(bucket.list(keys.folder(prefix)))
    nested = {other for other in models_in(listed) if other != prefix}
    runs = list(bucket.list(keys.run_folder(prefix)))
    for info in runs:
        inner, _, name = info.key.removeprefix("runs/").rpartition("/")
        if name in _RUN_MARKS and inner != prefix:
            nested.add(inner)
    rollouts = [
        info
        for info in bucket.list(keys.rollouts_folder(prefix))
        if keys.rollout_key(prefix, info.key) is not None
    ]
    metrics: list[ObjectInfo] = []
    if metrics_prefix is not None and not _inside(metrics_prefix, [prefix]):
        folder = keys.folder(metrics_prefix)
        metrics = [
            info
            for info in bucket.list(folder)
            if _METRICS.fullmatch(info.key.removeprefix(folder))
        ]
    own = [info for info in listed if not _inside(info.key, [*nested, *spared])]
    records = [info for info in runs if not _inside(info.key.removeprefix("runs/"), nested)]
    everything = {info.key: info for info in (*own, *metrics, *rollouts, *records)}
    ordered = sorted(everything.values(), key=lambda info: (_rank(prefix, info.key), info.key))
    pointers = {keys.folder(prefix) + pointer for pointer in POINTERS}
    return ModelTraces(prefix, tuple(ordered), bool(pointers & everything.keys()))


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

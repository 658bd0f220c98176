"""Lists the models in a bucket with their checkpoints."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime
from fnmatch import fnmatchcase

from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.scores import Score
from drcli.store import keys, lease
from drcli.store.bucket import Bucket, ObjectInfo
from drcli.store.repair import Model, readable_scores

_MARKS = ("/model/deepracer_checkpoints.json", "/model/.coach_checkpoint")
"""What a folder with a model has."""


@dataclass(frozen=True)
class CheckpointEntry:
    """A checkpoint in the list.

    Attributes:
        name: Such as `12_Step-7824.ckpt`.
        metric: What its evaluation scored on average; None before one.
    """

    name: str
    metric: float | None


@dataclass(frozen=True)
class ModelEntry:
    """A model.

    Attributes:
        prefix: Its folder.
        checkpoints: How many checkpoints it has.
        best: The best of them; None where that is unknown.
        last: The newest; None where that is unknown.
        objects: How many objects it consists of, logs and traces included.
        size_bytes: Their size.
        modified: When the newest of them was written, ISO 8601.
        training: Whether it is being trained now.
        damaged: What is damaged of its index, a sentence; the checkpoints are then what could be
            rebuilt.
    """

    prefix: str
    checkpoints: int
    best: CheckpointEntry | None
    last: CheckpointEntry | None
    objects: int
    size_bytes: int
    modified: str
    training: bool
    damaged: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ModelList:
    """The models of a bucket.

    Attributes:
        bucket: Its name.
        pattern: What the prefixes were searched for; empty for all.
        models: Sorted by prefix.
    """

    bucket: str
    pattern: str
    models: list[ModelEntry]


def list_models(bucket: Bucket, pattern: str = "") -> ModelList:
    """Look through a bucket.

    Args:
        bucket: Where to look.
        pattern: Part of a prefix, or all of it with `*` and `?` for anything.

    Raises:
        StorageError: The bucket cannot be read.
    """
    listed = bucket.list("")
    prefixes = {info.key.removesuffix(m) for info in listed for m in _MARKS if info.key.endswith(m)}
    own = _by_model(listed, prefixes)
    found = [_entry(bucket, p, own[p]) for p in sorted(prefixes) if _fits(p, pattern)]
    return ModelList(bucket.name, pattern, found)


def _by_model(listed: Iterable[ObjectInfo], prefixes: set[str]) -> dict[str, list[ObjectInfo]]:
    """Each object with the innermost model that it lies in: models may lie in folders of others."""
    own: dict[str, list[ObjectInfo]] = {prefix: [] for prefix in prefixes}
    for info in listed:
        folder = info.key
        while "/" in folder:
            folder = folder.rpartition("/")[0]
            if folder in own:
                own[folder].append(info)
                break
    return own


def _fits(prefix: str, pattern: str) -> bool:
    if any(character in pattern for character in "*?["):
        return fnmatchcase(prefix, pattern)
    return pattern in prefix


def _entry(bucket: Bucket, prefix: str, objects: list[ObjectInfo]) -> ModelEntry:
    names: set[CheckpointName] = set()
    for info in objects:
        name = keys.checkpoint_of(prefix, info.key)
        if name is not None:
            names.add(name)
    scores, damaged = readable_scores(Model(bucket, prefix, keys.metrics_prefix(prefix)))
    held = lease.holder(bucket, prefix)
    newest: datetime = max(info.modified for info in objects)
    return ModelEntry(
        prefix=prefix,
        checkpoints=len(names),
        best=None if scores is None else _checkpoint(scores.best_checkpoint),
        last=None if scores is None else _checkpoint(scores.last_checkpoint),
        objects=len(objects),
        size_bytes=sum(info.size_bytes for info in objects),
        modified=newest.isoformat(timespec="seconds"),
        training=held is not None and lease.is_owner_alive(held),
        damaged=damaged,
    )


def _checkpoint(score: Score) -> CheckpointEntry:
    return CheckpointEntry(score.name, score.avg_eval_metric)

"""Chooses a checkpoint of a model and reads its files."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Literal

from drcli.base.errors import SettingsError
from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.scores import Score, Scores
from drcli.store import keys
from drcli.store.bucket import Bucket, Listing, ObjectDamaged
from drcli.store.checkpoints import CheckpointStore
from drcli.store.repair import Model, readable_scores

Choice = Literal["last", "best"] | int
"""The newest checkpoint, the one that was evaluated best, or the one with this number."""

OUR_PARTS = (".safetensors", ".json")
"""What a checkpoint of ours cannot do without."""


class CheckpointGone(SettingsError):
    """The checkpoint that was chosen is not there, or not whole: a training may have pruned it."""


@dataclass(frozen=True)
class Item:
    """An object to be copied.

    Attributes:
        name: Its key below the model prefix.
    """

    name: str
    data: bytes


@dataclass(frozen=True)
class Chosen:
    """A checkpoint whose files are all there.

    Attributes:
        parts: What follows its name in the keys of its files.
    """

    choice: Choice
    score: Score
    parts: tuple[str, ...]
    size_bytes: int

    @property
    def name(self) -> str:
        """Such as `12_Step-7824.ckpt`."""
        return self.score.name

    @property
    def number(self) -> int:
        """The part before `_Step`."""
        return int(self.name.partition("_")[0])

    @property
    def line(self) -> str:
        """What the reference prints about it, which scripts look for."""
        if self.choice == "last":
            return f"Latest checkpoint = {self.number}"
        if self.choice == "best":
            return f"Best checkpoint: {self.number}"
        return f"Chosen checkpoint: {self.number}"


def choose(bucket: Bucket, prefix: str, choice: Choice) -> Chosen:
    """Find a checkpoint of a model.

    Raises:
        CheckpointGone: It has no such checkpoint, or one of its files is missing.
        SettingsError: There is no model.
        StorageError: The bucket cannot be read.
    """
    scores, _ = readable_scores(Model(bucket, prefix, keys.metrics_prefix(prefix)))
    if scores is None and not isinstance(choice, int):
        raise SettingsError(
            f"No checkpoint file available at s3://{bucket.name}/"
            f"{keys.deepracer_checkpoints(prefix)}. Exiting.",
            remedy="Train that model first, or correct its prefix; `dr-list-models` shows all.",
        )
    listed = bucket.list(keys.model_folder(prefix))
    score = _score(scores, listed, prefix, choice)
    missing = missing_parts(listed, prefix, score.name)
    if missing:
        raise CheckpointGone(
            "No model files found. Files possibly deleted. Try again. "
            f"s3://{bucket.name}/{missing[0]} is missing.",
            remedy="Run the command again, or choose another checkpoint with -b or -c N.",
        )
    start = keys.checkpoint_part(prefix, score.name, "")
    files = [info for info in listed if info.key.startswith(start + ".")]
    parts = tuple(info.key.removeprefix(start) for info in files)
    return Chosen(choice, score, parts, sum(info.size_bytes for info in files))


def missing_parts(listed: Listing, prefix: str, name: str) -> list[str]:
    """Keys of the files that a checkpoint lacks; those of our own format if it has no file."""
    there = {info.key for info in listed}
    lacks = [
        [key for part in parts if (key := keys.checkpoint_part(prefix, name, part)) not in there]
        for parts in (OUR_PARTS, keys.TENSORFLOW_PARTS)
    ]
    ours, theirs = lacks
    some_of_theirs = len(theirs) < len(keys.TENSORFLOW_PARTS)
    return theirs if len(ours) == len(OUR_PARTS) and some_of_theirs else ours


def read_checkpoint(bucket: Bucket, prefix: str, chosen: Chosen) -> list[Item]:
    """Read the files of a checkpoint, ours checked against what its record says.

    An optimizer state that is damaged or just being replaced is left out: weights go on without.

    Raises:
        ObjectMissing: One of them has just been deleted.
        ObjectDamaged: One of them is not what was written.
    """
    names = {part: f"model/{chosen.name}{part}" for part in chosen.parts}
    items = []
    if all(part in names for part in OUR_PARTS):
        found = CheckpointStore(bucket, prefix).load(chosen.name, with_optimizer=True)
        record = found.record if found.optimizer else replace(found.record, optimizer=None)
        items.append(Item(names.pop(".safetensors"), found.tensors))
        optimizer = names.pop(
            ".optimizer.safetensors", f"model/{chosen.name}.optimizer.safetensors"
        )
        if found.optimizer is not None:
            items.append(Item(optimizer, found.optimizer))
        items.append(Item(names.pop(".json"), json.dumps(asdict(record)).encode()))
    theirs = [names[part] for part in keys.TENSORFLOW_PARTS if part in names]
    items += [_filled(bucket, prefix, name) for name in theirs]
    graph = keys.checkpoint_graph(prefix, chosen.number)
    if bucket.exists(graph):
        items.append(_filled(bucket, prefix, graph.removeprefix(keys.folder(prefix))))
    return items


def _score(scores: Scores | None, listed: Listing, prefix: str, choice: Choice) -> Score:
    """The checkpoint that is meant; a number needs no index."""
    if scores is not None and choice == "best":
        return scores.best_checkpoint
    if scores is not None and choice == "last":
        return scores.last_checkpoint
    names = {keys.checkpoint_of(prefix, info.key) for info in listed}
    same = sorted(name for name in names if name is not None and name.number == choice)
    if not same:
        raise CheckpointGone(
            "No model files found. Files possibly deleted. Try again. There is no checkpoint "
            f"{choice}; there are {_numbers(names)}.",
            remedy="Choose one of them with -c N.",
        )
    whole = [name for name in same if not missing_parts(listed, prefix, str(name))]
    name = str((whole or same)[-1])
    known = () if scores is None else (scores.best_checkpoint, scores.last_checkpoint)
    return next((score for score in known if score.name == name), Score(name, None, 0.0))


def _numbers(names: Iterable[CheckpointName | None]) -> str:
    numbers = sorted({name.number for name in names if name is not None})
    return ", ".join(map(str, numbers)) or "none"


def _filled(bucket: Bucket, prefix: str, name: str) -> Item:
    data = bucket.get(keys.folder(prefix) + name)
    if not data:
        raise ObjectDamaged(
            f"{bucket.name}/{keys.folder(prefix)}{name} is empty.",
            remedy="Restore it from a copy, or choose another checkpoint.",
        )
    return Item(name, data)

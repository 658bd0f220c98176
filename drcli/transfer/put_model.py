"""Writes a model to a prefix so that readers never see an incomplete one.

Checkpoint files, then shared ones, pointers last; each object is checked. Equal objects are not
sent again, so repeating an interrupted delivery completes it.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from typing import Annotated, TypeVar

from drcli.base.errors import DrError, StorageError
from drcli.base.report import counted, size_text
from drcli.bucket.bucket import ObjectDamaged, ObjectInfo, ObjectMissing, Watch
from drcli.model import keys
from drcli.model.best_checkpoint import read_scores
from drcli.model.checkpoint_choice import missing_parts
from drcli.model.checkpoint_list import Item
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.model_store import ModelStore
from drcli.model.verify import MD5_DIGITS, Checksums
from drcli.records.scores import Score, Scores, encode_single

Progress = Callable[[str, int], AbstractContextManager[Watch]]
"""A progress bar for a `with` block."""

POINTERS = ("model/.coach_checkpoint", "model/deepracer_checkpoints.json")
_SENDINGS = 4
_BATCH_BYTES = 64 << 20
_LOOKS = 5


@dataclass(frozen=True)
class TransferReport:
    """The result of an upload or a download."""

    source: Annotated[str, "The model, as an s3:// address."]
    target: Annotated[str, "The copy, as an s3:// address."]
    checkpoint: Annotated[str, "Name of the checkpoint to use; the last one of a whole model."]
    copied: Annotated[list[str], "Names of the copied objects, below the target."] = field(
        default_factory=list
    )
    copied_bytes: Annotated[int, "Their size."] = 0
    unchanged: Annotated[list[str], "Names of the objects that already existed."] = field(
        default_factory=list
    )
    deleted: Annotated[list[str], "Names of the objects that -w deleted."] = field(
        default_factory=list
    )
    dry_run: Annotated[bool, "Whether -d was given, so that nothing was changed."] = False
    replay_bytes: Annotated[int, "Size of the replay buffer, which is not copied."] = field(
        default=0, kw_only=True
    )

    def size_text(self) -> str:
        same = f", {len(self.unchanged)} already there" if self.unchanged else ""
        return f"{counted(len(self.copied), 'file')}, {size_text(self.copied_bytes)}{same}"

    def copied_text(self) -> str:
        return f"{self.source} to {self.target}: {self.size_text()}."

    def replay_text(self) -> str:
        if not self.replay_bytes:
            return ""
        return (
            f"Its replay buffer ({size_text(self.replay_bytes)}) is not copied: SAC goes on from "
            "the copy with an empty one, which costs some iterations."
        )


def replay_bytes(model: ModelStore) -> int:
    """Size of the rollouts that the model learns from again; 0 if unknown."""
    with suppress(DrError):
        metadata = ModelMetadata.from_bytes(model.bucket.get(keys.model_metadata(model.prefix)), "")
        if metadata.algorithm.replay:
            listed = model.bucket.list(keys.rollouts_folder(model.prefix))
            own = (info for info in listed if keys.rollout_key(model.prefix, info.key) is not None)
            return sum(info.size_bytes for info in own)
    return 0


Report = TypeVar("Report", bound=TransferReport)


class Delivery:
    def __init__(self, model: ModelStore, watch: Watch) -> None:
        self.copied: list[str] = []
        self.copied_bytes = 0
        self.unchanged: list[str] = []
        self.deleted: list[str] = []
        self.bucket = model.bucket
        self._folder = keys.folder(model.prefix)
        self.prefix = model.prefix
        self._watch = watch
        self._sent: dict[str, Checksums] = {}
        self._there = self._look()

    def differs(self, item: Item) -> bool:
        return item.name in self._there and not self.holds(item)

    def holds(self, item: Item) -> bool:
        return Checksums.of(item.data).matches(self.bucket, self._there.get(item.name))

    def has(self, name: str, info: ObjectInfo) -> bool:
        """Judged by its etag; it counts as unchanged then."""
        own = self._there.get(name)
        if own is None or len(info.etag) < MD5_DIGITS or own.size_bytes != info.size_bytes:
            return False
        same = info.etag in Checksums.of(self.bucket.get(own.key)).etags
        if same and name not in self.unchanged:
            self.unchanged.append(name)
        return same

    def send(self, items: Iterable[Item]) -> None:
        """Send and check; raises ObjectDamaged."""
        batch: list[Item] = []
        for item in items:
            proof = self._sent[item.name] = Checksums.of(item.data)
            if proof.matches(self.bucket, self._there.get(item.name)):
                self.unchanged.append(item.name)
                self._watch(len(item.data))
                continue
            self.copied.append(item.name)
            self.copied_bytes += len(item.data)
            batch.append(item)
            if sum(len(waiting.data) for waiting in batch) > _BATCH_BYTES:
                self._send(batch, self._watch)
                batch = []
        self._send(batch, self._watch)

    def withdraw(self) -> None:
        """Delete the pointers: no model is usable until `publish`."""
        self.bucket.delete([self._folder + name for name in reversed(POINTERS)])
        for name in POINTERS:
            self._there.pop(name, None)

    def publish(self, score: Score) -> None:
        self._point(score)
        self.copied += POINTERS

    def delete_strays(self, folder: str, kept: Iterable[str] = ()) -> None:
        strays = self.strays(folder, [*self._sent, *kept])
        self.bucket.delete([self._folder + name for name in strays])
        self.deleted += strays

    def strays(self, folder: str, kept: Iterable[str]) -> list[str]:
        stay = {*kept, *POINTERS}
        return [name for name in self._look() if name.startswith(folder) and name not in stay]

    def named(self) -> set[str]:
        """Checkpoints that the pointers name."""
        scores, pointed = self._pointed()
        of_index = () if scores is None else (scores.best_checkpoint, scores.last_checkpoint)
        return {pointed or "", *(score.name for score in of_index)} - {""}

    def repair_crossing(self, score: Score, needed: Sequence[Item]) -> None:
        """Check whether another delivery interfered, and repair the result.

        When two cross, files may be missing, and index and pointer differ. The later index counts
        if its checkpoint is complete.

        Raises:
            StorageError: Others keep changing it.
        """
        for _ in range(_LOOKS):
            listed = self.bucket.list(keys.model_folder(self.prefix))
            scores, pointed = self._pointed()
            named = None if scores is None else scores.last_checkpoint.name
            if named is None or (named != score.name and missing_parts(listed, self.prefix, named)):
                self._point(score)
            elif named == score.name and (altered := self._altered(item.name for item in needed)):
                self._send([item for item in needed if item.name in altered])
            elif pointed != named:
                self.bucket.put(keys.coach_checkpoint(self.prefix), named.encode())
            else:
                return
        raise self._crossed()

    def confirm(self, names: Iterable[str]) -> None:
        """Check that objects are as sent; else delete the pointers.

        Raises:
            StorageError: Another program delivers here.
        """
        if self._altered(name for name in names if name in self._sent):
            self.withdraw()
            raise self._crossed()

    def complete(self, report: Report) -> Report:
        return replace(
            report,
            copied=self.copied,
            copied_bytes=self.copied_bytes,
            unchanged=self.unchanged,
            deleted=self.deleted,
        )

    def _look(self) -> dict[str, ObjectInfo]:
        listed = self.bucket.list(self._folder)
        return {info.key.removeprefix(self._folder): info for info in listed}

    def _altered(self, names: Iterable[str]) -> list[str]:
        there = self._look()
        return [
            name for name in names if not self._sent[name].matches(self.bucket, there.get(name))
        ]

    def _send(self, items: Sequence[Item], watch: Watch | None = None) -> None:
        for _ in range(_SENDINGS):
            if not items:
                return
            for item in items:
                self.bucket.put(self._folder + item.name, item.data, watch=watch)
            altered = self._altered(item.name for item in items)
            items = [item for item in items if item.name in altered]
            watch = None
        if items:
            key = f"{self.bucket.name}/{self._folder}{items[0].name}"
            raise ObjectDamaged(
                f"The server stored s3://{key} wrongly {_SENDINGS} times.",
                remedy="Use another S3 server; this one would lose a model.",
            )

    def _point(self, score: Score) -> None:
        self.bucket.put(keys.coach_checkpoint(self.prefix), score.name.encode())
        self.bucket.put(keys.deepracer_checkpoints(self.prefix), encode_single(score))

    def _pointed(self) -> tuple[Scores | None, str | None]:
        scores = pointed = None
        with suppress(ObjectDamaged):
            scores = read_scores(ModelStore(self.bucket, self.prefix))
        with suppress(ObjectMissing):
            pointer = self.bucket.get(keys.coach_checkpoint(self.prefix))
            pointed = pointer.decode(errors="replace").strip()
        return scores, pointed

    def _crossed(self) -> StorageError:
        return StorageError(
            f"Another program keeps changing s3://{self.bucket.name}/{self.prefix}.",
            remedy="Run the command again when that program is done.",
        )

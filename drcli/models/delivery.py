"""Writes a model to a prefix so that readers never see an incomplete one.

The files of the checkpoint go first, then what all checkpoints share, the pointers last. Every
object is verified after it was written. One that is there already is not sent again, so repeating
an interrupted delivery completes it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from drcli.base.errors import StorageError
from drcli.exchange.scores import Score, encode_single
from drcli.models.checkpoint_choice import Item, missing_parts
from drcli.models.checkpoint_files import SHAPING
from drcli.store import keys
from drcli.store.best_checkpoint import read_scores
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectInfo, ObjectMissing, Watch
from drcli.store.verify import Checksums

POINTERS = ("model/.coach_checkpoint", "model/deepracer_checkpoints.json")
"""Names of the two objects that say which checkpoint counts, in the order of writing."""

_SENDINGS = 3
"""How often an object is sent to a server that alters it."""

_BATCH_BYTES = 64 << 20
"""How much is sent before it is verified, and kept in memory until then."""

_LOOKS = 5
"""How often a delivery tries again when another one writes to the same prefix."""


@dataclass(frozen=True)
class TransferReport:
    """What was done.

    Attributes:
        source: The model, as an s3:// address.
        target: The copy, the same.
        checkpoint: Name of the checkpoint that counts; the last one of a whole model.
        copied: Names of the objects that travelled, below the target.
        copied_bytes: Their size.
        unchanged: Names of those that were there already.
        deleted: Names of those that -w deleted.
        dry_run: Whether nothing of this was really done.
    """

    source: str
    target: str
    checkpoint: str
    copied: list[str] = field(default_factory=list)
    copied_bytes: int = 0
    unchanged: list[str] = field(default_factory=list)
    deleted: list[str] = field(default_factory=list)
    dry_run: bool = False


Report = TypeVar("Report", bound=TransferReport)


class Delivery:
    """One delivery to one prefix.

    Args:
        watch: Told how many bytes have travelled.

    Attributes:
        copied: Names of the objects sent.
        copied_bytes: Their size.
        unchanged: Names of those that were there already.
        deleted: Names of those that were deleted.
    """

    def __init__(self, bucket: Bucket, prefix: str, watch: Watch) -> None:
        self.copied: list[str] = []
        self.copied_bytes = 0
        self.unchanged: list[str] = []
        self.deleted: list[str] = []
        self._bucket = bucket
        self._folder = keys.folder(prefix)
        self._prefix = prefix
        self._watch = watch
        self._checksums: dict[str, Checksums] = {}
        self._there = self._look()

    def differs(self, item: Item) -> bool:
        """Whether something else lies where an item goes."""
        return item.name in self._there and not self.holds(item)

    def holds(self, item: Item) -> bool:
        """Whether an item lies there as it is."""
        return Checksums.of(item.data).matches(self._bucket, self._there.get(item.name))

    def has(self, name: str, info: ObjectInfo) -> bool:
        """Whether the object of a listing elsewhere is here already, by its etag there.

        It counts as unchanged then.
        """
        own = self._there.get(name)
        if own is None or not info.etag or own.size_bytes != info.size_bytes:
            return False
        same = info.etag in Checksums.of(self._bucket.get(own.key)).etags
        if same and name not in self.unchanged:
            self.unchanged.append(name)
        return same

    def send(self, items: Iterable[Item]) -> None:
        """Send objects and verify that they arrived.

        Raises:
            StorageError: They cannot be written, or do not arrive as they are.
        """
        sent: dict[str, bytes] = {}
        for item in items:
            checksums = Checksums.of(item.data)
            self._checksums[item.name] = checksums
            if checksums.matches(self._bucket, self._there.get(item.name)):
                self.unchanged.append(item.name)
                self._watch(len(item.data))
                continue
            self._put(item)
            sent[item.name] = item.data
            if sum(map(len, sent.values())) > _BATCH_BYTES:
                self._prove(sent)
                sent = {}
        self._prove(sent)

    def withdraw(self) -> None:
        """Take the pointers away: nothing there counts until `publish`."""
        self._bucket.delete([self._folder + name for name in reversed(POINTERS)])
        for name in POINTERS:
            self._there.pop(name, None)

    def publish(self, score: Score) -> None:
        """Let the pointers name one checkpoint as the last and the best; the index comes last."""
        self._point(score)
        self.copied += POINTERS

    def sweep(self, folder: str, kept: Iterable[str]) -> None:
        """Delete what lies below a folder of the prefix and was not delivered.

        Args:
            folder: Such as `model/`, or empty for everything.
            kept: Names that stay besides.
        """
        doomed = self.strays(folder, [*self._checksums, *kept])
        self._bucket.delete([self._folder + name for name in doomed])
        self.deleted += doomed

    def strays(self, folder: str, kept: Iterable[str]) -> list[str]:
        """Names of what lies below a folder of the prefix beside these and the pointers."""
        stay = {*kept, *POINTERS}
        return [name for name in self._look() if name.startswith(folder) and name not in stay]

    def settle(self, score: Score, needed: Sequence[Item]) -> None:
        """Check whether another delivery to this prefix interfered, and repair what it broke.

        Two deliveries may cross: the index of one, the pointer of the other, and files that one
        has deleted while the other relied on them. The later index counts, as long as what it
        names is whole.

        Args:
            score: The checkpoint that this delivery has published.
            needed: Its files, and those without which its weights cannot be read.

        Raises:
            StorageError: Others keep changing it.
        """
        for _ in range(_LOOKS):
            listed = self._bucket.list(keys.model_folder(self._prefix))
            named, pointed = self._named()
            if named is None or (
                named != score.name and missing_parts(listed, self._prefix, named)
            ):
                self._point(score)
            elif named == score.name and self._lacks(needed):
                self._prove({item.name: item.data for item in needed})
            elif pointed != named:
                self._bucket.put(keys.coach_checkpoint(self._prefix), named.encode())
            else:
                return
        raise self._crossed()

    def confirm(self, names: Iterable[str]) -> None:
        """Look whether objects are still what was sent; where not, nothing there counts.

        Raises:
            StorageError: Somebody else delivers another model here.
        """
        there = self._look()
        sent = {name: self._checksums[name] for name in names if name in self._checksums}
        if not all(sums.matches(self._bucket, there.get(name)) for name, sums in sent.items()):
            self.withdraw()
            raise self._crossed()

    def told(self, report: Report) -> Report:
        """A report with what this delivery did."""
        return replace(
            report,
            copied=self.copied,
            copied_bytes=self.copied_bytes,
            unchanged=self.unchanged,
            deleted=self.deleted,
        )

    def _look(self) -> dict[str, ObjectInfo]:
        listed = self._bucket.list(self._folder)
        return {info.key.removeprefix(self._folder): info for info in listed}

    def _put(self, item: Item) -> None:
        self._bucket.put(self._folder + item.name, item.data, watch=self._watch)
        self.copied.append(item.name)
        self.copied_bytes += len(item.data)

    def _prove(self, sent: dict[str, bytes]) -> None:
        """Compare the objects there with what was sent, and send those again that differ."""
        wrong = dict(sent)
        for attempt in range(_SENDINGS + 1):
            there = self._look() if wrong else {}
            wrong = {
                name: data
                for name, data in wrong.items()
                if not self._checksums[name].matches(self._bucket, there.get(name))
            }
            if not wrong or attempt == _SENDINGS:
                break
            for name, data in wrong.items():
                self._bucket.put(self._folder + name, data)
        if wrong:
            key = f"{self._bucket.name}/{self._folder}{min(wrong)}"
            raise ObjectDamaged(
                f"s3://{key} does not hold what was written to it, {_SENDINGS} times.",
                remedy="Use another S3 server; this one would lose a model.",
            )

    def _point(self, score: Score) -> None:
        self._bucket.put(keys.coach_checkpoint(self._prefix), score.name.encode())
        self._bucket.put(keys.deepracer_checkpoints(self._prefix), encode_single(score))

    def _named(self) -> tuple[str | None, str | None]:
        """The checkpoint of the index and that of the pointer."""
        try:
            scores = read_scores(self._bucket, self._prefix)
            pointed = self._bucket.get(keys.coach_checkpoint(self._prefix)).decode().strip()
        except (ObjectMissing, ObjectDamaged):
            return None, None
        return (None, None) if scores is None else (scores.last_checkpoint.name, pointed)

    def _crossed(self) -> StorageError:
        return StorageError(
            f"Another program keeps changing s3://{self._bucket.name}/{self._prefix}.",
            remedy="Run the command again when that program is done.",
        )

    def _lacks(self, needed: Sequence[Item]) -> bool:
        """Whether one of these is not there; those whose size tells nothing are compared."""
        there = self._look()
        for item in needed:
            info = there.get(item.name)
            if info is None or info.size_bytes != len(item.data):
                return True
            if item.name in SHAPING and not self._checksums[item.name].matches(self._bucket, info):
                return True
        return False

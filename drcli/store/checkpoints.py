"""Checkpoints of a model in the bucket, written so that a reader never takes a damaged one.

A checkpoint is its tensors, optionally its optimizer's, and a small record with sizes, hashes and
counters. It counts from the moment the pointer names it, which is written after all of these. The
trainer alone writes here; everybody else reads.
"""

from dataclasses import dataclass, replace
from functools import partial

from drcli.base.errors import StorageError
from drcli.base.fingerprint import Fingerprint
from drcli.exchange.checkpoint import (
    CheckpointName,
    CheckpointRecord,
    Counters,
    checkpoint_name,
    decode_pointer,
    encode_pointer,
)
from drcli.exchange.scores import EvaluationResult
from drcli.store import best_checkpoint, keys
from drcli.store.best_checkpoint import read_scores, write_scores
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record

KEEP = 4
"""Newest checkpoints that pruning leaves, beside the best one. Source: the reference simulator."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint whose bytes are the ones its record speaks of.

    Args:
        record: Name, hashes and counters.
        tensors: Weights, a safetensors file.
        optimizer: Optimizer state, a safetensors file; None where none was saved or asked for.
        damaged: Newer checkpoints that were passed over, each with the reason.
    """

    record: CheckpointRecord
    tensors: bytes
    optimizer: bytes | None = None
    damaged: tuple[str, ...] = ()


class CheckpointStore:
    """The checkpoints below one model prefix."""

    def __init__(self, bucket: Bucket, prefix: str) -> None:
        self._bucket = bucket
        self._prefix = prefix

    def save(
        self,
        number: int,
        steps: int,
        tensors: bytes,
        *,
        optimizer: bytes | None = None,
        sim_time_s: float = 0.0,
        counters: Counters | None = None,
    ) -> CheckpointRecord:
        """Write a checkpoint, let the pointer name it, and drop what is too old.

        Args:
            number: One more than the checkpoint before, from 0.
            steps: Environment steps learned from until now.
            tensors: Weights, a safetensors file.
            optimizer: State to continue with, a safetensors file.
            sim_time_s: Simulated seconds driven until now.
            counters: What the trainer continues with.

        Returns:
            The record as written.
        """
        name = str(CheckpointName(number, steps))
        record = CheckpointRecord(
            name,
            Fingerprint.of(tensors),
            None if optimizer is None else Fingerprint.of(optimizer),
            sim_time_s,
            counters or Counters(),
        )
        self._bucket.put(keys.checkpoint_tensors(self._prefix, name), tensors)
        if optimizer is not None:
            self._bucket.put(keys.checkpoint_optimizer(self._prefix, name), optimizer)
        self._bucket.put(keys.checkpoint_record(self._prefix, name), record.encode())
        self.point_to(record)
        self._prune(record)
        return record

    def attach_optimizer(self, record: CheckpointRecord, optimizer: bytes) -> CheckpointRecord:
        """Add the optimizer state to a published checkpoint, and drop those of older ones.

        The weights are what everybody waits for, so they are published alone; the state, twice
        their size, follows while the workers already drive. The state of the checkpoint before
        stays, for a trainer that has to go back to that one.
        """
        complete = replace(record, optimizer=Fingerprint.of(optimizer))
        self._bucket.put(keys.checkpoint_optimizer(self._prefix, record.name), optimizer)
        self._bucket.put(keys.checkpoint_record(self._prefix, record.name), complete.encode())
        self._bucket.delete(self._older_optimizers(checkpoint_name(record.name)))
        return complete

    def _older_optimizers(self, newest: CheckpointName) -> list[str]:
        """Keys of all optimizer states but the newest checkpoint's and that of the one before."""
        objects = checkpoint_objects(self._bucket, self._prefix)
        states = {key: name for key, name in objects.items() if keys.is_optimizer(key)}
        before = max((name for name in states.values() if name < newest), default=None)
        return [key for key, name in states.items() if name not in (before, newest)]

    def point_to(self, record: CheckpointRecord) -> None:
        """Make this checkpoint the one that everybody drives and continues with.

        `save` does so itself. A trainer that had to fall back on an older checkpoint points to
        that one, so that the workers play it as well.
        """
        pointer = encode_pointer(checkpoint_name(record.name))
        self._bucket.put(keys.coach_checkpoint(self._prefix), pointer)
        try:
            known = read_scores(self._bucket, self._prefix)
        except ObjectDamaged:
            known = None  # the best is forgotten; the training can go on
        scores = best_checkpoint.with_newest(known, record.name, record.sim_time_s)
        write_scores(self._bucket, self._prefix, scores)

    def repair_pointer(self, name: CheckpointName) -> bool:
        """Write the pointer again where it is gone, damaged, or names an older checkpoint.

        One that names a newer checkpoint is somebody else's, who went on from this one.

        Returns:
            Whether it was written.
        """
        pointed = self.pointed()
        if pointed is not None and pointed.number >= name.number:
            return False
        self.point_to(self.record(str(name)))
        return True

    def latest_name(self) -> str | None:
        """The checkpoint that the pointer names, None before the first; cheap enough to poll.

        Raises:
            ObjectDamaged: The pointer holds something else.
        """
        key = keys.coach_checkpoint(self._prefix)
        remedy = "Go on with `dr-start-training --resume`, which writes it again."
        try:
            return str(read_record(self._bucket, key, decode_pointer, remedy))
        except ObjectMissing:
            return None

    def pointed(self) -> CheckpointName | None:
        """The same for those who wait: None too while the pointer is damaged.

        The trainer writes it again as soon as it notices.
        """
        try:
            return CheckpointName.parse(self.latest_name() or "")
        except ObjectDamaged:
            return None

    def drivers(self, newest: CheckpointName) -> list[str]:
        """Checkpoints that may have driven what is learned from while this is the newest one.

        Workers that drive while the trainer learns are one checkpoint behind.

        Returns:
            The newest last, before it the one with the number before, where there is one.
        """
        names = set(checkpoint_objects(self._bucket, self._prefix).values())
        before = [str(name) for name in names if name.number == newest.number - 1]
        return [*before, str(newest)]

    def record(self, name: str) -> CheckpointRecord:
        """Sizes, hashes and counters of a checkpoint.

        Raises:
            ObjectMissing: There is no such checkpoint.
            ObjectDamaged: There is, but its record is unreadable.
        """
        key = keys.checkpoint_record(self._prefix, name)
        remedy = "Delete that checkpoint's files; an older one is used instead."
        return read_record(self._bucket, key, partial(CheckpointRecord.decode_of, name), remedy)

    def load(self, name: str, *, with_optimizer: bool = False) -> Checkpoint:
        """Read one checkpoint and check it.

        Raises:
            ObjectMissing: One of its files is missing.
            ObjectDamaged: Its record or weights are damaged; the sentence names the file.
        """
        record = self.record(name)
        tensors = self._checked(keys.checkpoint_tensors(self._prefix, name), record.tensors)
        optimizer = self._optimizer(record) if with_optimizer else None
        return Checkpoint(record, tensors, optimizer)

    def load_latest(self, *, with_optimizer: bool = False) -> Checkpoint | None:
        """Read the newest checkpoint that is whole.

        That is the one the pointer names; when it is damaged, the newest older one, and
        `damaged` of the result says what was passed over and why.

        Returns:
            None when the model has no checkpoint at all.

        Raises:
            StorageError: There are checkpoints, but none is whole.
        """
        damaged: list[str] = []
        for name in self._newest_first():
            try:
                found = self.load(name, with_optimizer=with_optimizer)
            except (ObjectMissing, ObjectDamaged) as e:
                damaged.append(f"{name}: {e}")
            else:
                return Checkpoint(found.record, found.tensors, found.optimizer, tuple(damaged))
        if not damaged:
            return None
        raise StorageError(
            f"No checkpoint below {self._bucket.name}/{keys.model_folder(self._prefix)} is whole: "
            + " ".join(damaged),
            remedy="Restore one from a copy, or train the model anew with `-w`.",
        )

    def best_name(self) -> str | None:
        """The checkpoint with the best evaluation so far, None before the first checkpoint."""
        scores = read_scores(self._bucket, self._prefix)
        return None if scores is None else scores.best_checkpoint.name

    def record_evaluation(self, result: EvaluationResult, metric: str) -> bool:
        """Record how a checkpoint was evaluated; True when it is now the best.

        One that was pruned meanwhile cannot become the best any more.

        Args:
            result: Of its evaluation.
            metric: DR_TRAIN_BEST_MODEL_METRIC.
        """
        scores = read_scores(self._bucket, self._prefix)
        try:
            time_stamp = self.record(result.checkpoint).sim_time_s
        except ObjectMissing:
            return False
        if scores is None:
            return False
        score = best_checkpoint.score_of(result, metric, time_stamp)
        after = best_checkpoint.with_evaluation(scores, score, metric)
        write_scores(self._bucket, self._prefix, after)
        return after.best_checkpoint == score

    def forget_damaged_best(self) -> str | None:
        """Let the last checkpoint stand for the best one where the weights of that are damaged.

        Returns:
            What is damaged, None where nothing is.
        """
        known = read_scores(self._bucket, self._prefix)
        if known is None:
            return None
        try:
            self.load(known.best_checkpoint.name)
        except (ObjectMissing, ObjectDamaged) as error:
            write_scores(self._bucket, self._prefix, best_checkpoint.without_best(known))
            return str(error)
        return None

    def forget_scores(self) -> None:
        """Keep the best checkpoint, but not how good it was: the next evaluation beats it."""
        known = read_scores(self._bucket, self._prefix)
        if known is not None:
            write_scores(self._bucket, self._prefix, best_checkpoint.without_metrics(known))

    def _optimizer(self, record: CheckpointRecord) -> bytes | None:
        """The optimizer state where it is there and whole: weights alone can go on, too."""
        if record.optimizer is None:
            return None
        try:
            return self._checked(
                keys.checkpoint_optimizer(self._prefix, record.name), record.optimizer
            )
        except (ObjectMissing, ObjectDamaged):
            return None

    def _checked(self, key: str, fingerprint: Fingerprint) -> bytes:
        data = self._bucket.get(key)
        fault = fingerprint.fault(data)
        if fault is not None:
            raise ObjectDamaged(
                f"{self._bucket.name}/{key} is damaged: {fault}.",
                remedy="Restore it from a copy, or choose another checkpoint; `dr-start-training "
                "--resume` goes on without it.",
            )
        return data

    def _newest_first(self) -> list[str]:
        """Where to look for a whole checkpoint.

        What is newer than the pointer was never published and is left alone; so is one without a
        record, which a trainer had only begun to write.
        """
        objects = checkpoint_objects(self._bucket, self._prefix)
        found = {name for key, name in objects.items() if key.endswith(".ckpt.json")}
        pointed = self.pointed()
        if pointed is not None:
            found = {name for name in found if name < pointed} | {pointed}
        return [str(name) for name in sorted(found, reverse=True)]

    def _prune(self, newest: CheckpointRecord) -> None:
        """Delete all but the newest checkpoints and the best.

        A checkpoint that counts further than the newest was left by a trainer that died before
        it published it, or was passed over as damaged; its place is taken again.
        """
        objects = checkpoint_objects(self._bucket, self._prefix)
        names = set(objects.values())
        older = sorted(name for name in names if name.number < newest.number)
        kept = {str(name) for name in older[-(KEEP - 1) :]} | {newest.name, self.best_name()}
        doomed = {name for name in names if str(name) not in kept}
        numbers = {name.number for name in names - doomed}
        graphs = [
            keys.checkpoint_graph(self._prefix, name.number)
            for name in doomed
            if name.number not in numbers
        ]
        self._bucket.delete([key for key, name in objects.items() if name in doomed] + graphs)


def checkpoint_objects(bucket: Bucket, prefix: str) -> dict[str, CheckpointName]:
    """Keys of everything that belongs to a checkpoint of a model, and to which."""
    found = {
        o.key: keys.checkpoint_of(prefix, o.key) for o in bucket.list(keys.model_folder(prefix))
    }
    return {key: name for key, name in found.items() if name is not None}

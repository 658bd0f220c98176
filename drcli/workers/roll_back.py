"""Lets a trainer go back to its last good checkpoint; it may be killed at any point.

The decision is one write (`Rollbacks`). The rest is what a trainer does when it starts.
"""

import time
from dataclasses import replace

from drcli.base.errors import TrainingFailed
from drcli.base.log import get_logger
from drcli.exchange.checkpoint import CheckpointName, checkpoint_name
from drcli.exchange.job import Job
from drcli.exchange.rollback_record import RATE_FACTOR, Reason, Rollback, Rollbacks
from drcli.learn.update_result import NonFiniteLossError
from drcli.store.best_checkpoint import read_scores
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.checkpoints import Checkpoint, CheckpointStore, checkpoint_objects
from drcli.store.history import SMOOTH
from drcli.store.rollbacks import read_rollbacks, write_rollbacks

_logger = get_logger(__name__)


LOOK_BACK = 3


class RolledBack(Exception):
    """Begin again from the bucket."""


class RollbackControl:
    def __init__(self, bucket: Bucket, job: Job, checkpoints: CheckpointStore) -> None:
        self._bucket = bucket
        self._job = job
        self._prefix = job.config.model.prefix
        self._checkpoints = checkpoints
        try:
            self.known = read_rollbacks(bucket, self._prefix)
        except ObjectDamaged as error:
            _logger.warning("%s The training goes on as if there had been none.", error)
            self.known = Rollbacks()

    @property
    def left(self) -> int:
        return max(0, self._job.config.train.train_max_rollbacks - self.known.count)

    def load_latest(self) -> Checkpoint | None:
        """With its optimizer; None if the model has none.

        Raises:
            StorageError: All checkpoints are damaged.
        """
        found = self._checkpoints.load_latest(with_optimizer=True)
        target = None if found is None else self.known.pending(found.record)
        if target is None:
            return found
        older = self._checkpoints.load_latest(with_optimizer=True, newest=target)
        if older is None:
            _logger.warning("Checkpoint %d is lost; the training cannot go back.", target.number)
        return older or found

    def mark(self, found: Checkpoint) -> None:
        """Note in the checkpoint how often the training went back."""
        counters = found.record.counters
        if (counters.rollbacks or 0) < self.known.count:
            counters = replace(counters, rollbacks=self.known.count)
            self._checkpoints.rewrite(replace(found.record, counters=counters))

    def decide(
        self,
        reason: Reason,
        text: str,
        newest: CheckpointName,
        lr: float,
        elapsed_s: float,
        *,
        first: int = 0,
    ) -> Rollback | None:
        """Go back, if that is allowed and there is a good checkpoint.

        `first` is the oldest one to go back to, the first of a stage.

        Returns:
            What is stored now; None if the training does not go back.
        """
        target = self._target(reason, newest, first) if self.left else None
        if target is None:
            return None
        rollback = Rollback(
            at=time.time(),
            reason=reason,
            text=text,
            left=str(newest),
            target=str(target),
            lr=lr,
            factor=self.known.factor(lr) * RATE_FACTOR,
            elapsed_s=elapsed_s,
            session=self._job.session,
        )
        self.known = Rollbacks([*self.known.entries, rollback])
        write_rollbacks(self._bucket, self._prefix, self.known)
        return rollback

    def nan_failure(
        self, error: NonFiniteLossError, iteration: int, *, sac: bool
    ) -> TrainingFailed:
        shorter = "" if sac else ", or set `max_grad_norm` to 0.5,"  # which only PPO reads
        remedy = (
            f"Lower `lr` to a third{shorter} in hyperparameters.json, then "
            "continue with `dr-start-training --resume`. DR_TRAIN_MAX_ROLLBACKS=2 does it "
            "without you."
        )
        best = CheckpointName.parse(self._checkpoints.best_name() or "")
        if best is not None:
            remedy += f" Or start a new model from checkpoint {best.number}, the best, with "
            remedy += "DR_LOCAL_S3_PRETRAINED=True."
        return TrainingFailed(
            "NaN detected in loss function, aborting training. "
            f"Iteration {iteration}: {error} "
            "The weights from before this iteration are kept as the last checkpoint.",
            remedy=remedy,
        )

    def _target(self, reason: Reason, newest: CheckpointName, first: int) -> CheckpointName | None:
        """After a collapse, the best checkpoint.

        A NaN announces itself a few updates before, so the oldest of the newest is taken, but
        none before the best one.
        """
        best = self._best()
        if best is not None and best.number < first:
            best = None  # of another stage
        if reason == "collapse":
            # What was so good just now has not collapsed.
            old_enough = best is not None and best.number <= newest.number - SMOOTH
            return best if best is not None and old_enough and self._is_intact(best) else None
        names = sorted(set(checkpoint_objects(self._bucket, self._prefix).values()))
        oldest = best.number if best is not None else first
        candidates = [name for name in names if oldest <= name.number <= newest.number]
        recent = candidates[-LOOK_BACK:]
        return next((name for name in recent if self._is_intact(name)), None)

    def _best(self) -> CheckpointName | None:
        try:
            scores = read_scores(self._bucket, self._prefix)
        except ObjectDamaged:
            return None
        if scores is None or scores.best_checkpoint.avg_eval_metric is None:
            return None
        return checkpoint_name(scores.best_checkpoint.name)

    def _is_intact(self, name: CheckpointName) -> bool:
        try:
            self._checkpoints.load(str(name))
        except (ObjectMissing, ObjectDamaged):
            return False
        return True

"""The milestones of a model as its trainer knows them, in memory and in the bucket."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.milestone_record import Milestones
from drcli.exchange.scores import EvaluationResult
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged
from drcli.store.milestones import (
    NO_MILESTONES,
    read_milestones,
    with_history,
    with_results,
    write_milestones,
)


class MarkedCheckpoints:
    """Reads the record once, and writes it when it has changed. Only a trainer writes it.

    Args:
        bucket: Holds the model.
        prefix: Of the model.
        unmarked: Names the checkpoints that all stay if the record is lost.
    """

    def __init__(self, bucket: Bucket, prefix: str, unmarked: Callable[[], list[str]]) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._unmarked = unmarked
        self._known: Milestones | None = None

    @property
    def milestones(self) -> Milestones:
        """The milestones until now."""
        if self._known is None:
            try:
                found = read_milestones(self._bucket, self._prefix)
            except ObjectDamaged:
                found = replace(NO_MILESTONES, spaced=self._unmarked())
            self._known = found or NO_MILESTONES
        return self._known

    def add(self, result: EvaluationResult) -> None:
        """Note what an evaluation has reached."""
        self.write(with_results(self.milestones, [result]))

    def begin_stage(self, first: int) -> None:
        """Forget the fastest lap of the stage before; `first` is the new one's first checkpoint."""
        self.write(self.milestones.of_stage(first))

    def restore(self, newest: CheckpointName, records: Sequence[IterationRecord]) -> None:
        """Find the milestones again when a trainer starts, and write them if they have changed.

        A trainer may have ended between an evaluation and the record of a milestone, or have gone
        back to an older checkpoint. If the record is lost, every checkpoint that is there stays.

        Args:
            newest: The checkpoint that the trainer continues from.
            records: The learning curve until then.
        """
        if not self._bucket.exists(keys.milestones(self._prefix)):
            self._known = replace(NO_MILESTONES, spaced=self._unmarked())
        self.write(with_history(self.milestones.until(newest), records))

    def write(self, milestones: Milestones) -> None:
        """Write the record, unless it says this already."""
        if milestones != self._known:
            write_milestones(self._bucket, self._prefix, milestones)
        self._known = milestones

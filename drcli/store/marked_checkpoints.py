"""A trainer's milestones, in memory and in the bucket."""

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
    """Only a trainer writes it. If it is lost, `unmarked` checkpoints stay."""

    def __init__(self, bucket: Bucket, prefix: str, unmarked: Callable[[], list[str]]) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._unmarked = unmarked
        self._known: Milestones | None = None

    @property
    def milestones(self) -> Milestones:
        if self._known is None:
            try:
                found = read_milestones(self._bucket, self._prefix)
            except ObjectDamaged:
                found = replace(NO_MILESTONES, spaced=self._unmarked())
            self._known = found or NO_MILESTONES
        return self._known

    def add(self, result: EvaluationResult) -> None:
        self.write(with_results(self.milestones, [result]))

    def begin_stage(self, first: int) -> None:
        self.write(self.milestones.of_stage(first))

    def restore(self, newest: CheckpointName, records: Sequence[IterationRecord]) -> None:
        """Find the milestones again when a trainer starts.

        It may have ended between evaluation and record, or have gone back. If the record is lost,
        every checkpoint stays.
        """
        if not self._bucket.exists(keys.milestones(self._prefix)):
            self._known = replace(NO_MILESTONES, spaced=self._unmarked())
        self.write(with_history(self.milestones.until(newest), records))

    def write(self, milestones: Milestones) -> None:
        if milestones != self._known:
            write_milestones(self._bucket, self._prefix, milestones)
        self._known = milestones

"""The milestones of a model: read, written, worked out from evaluations."""

from collections.abc import Iterable

from drcli.exchange.checkpoint import CheckpointName, checkpoint_name
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.milestone_record import Milestones
from drcli.exchange.scores import EvaluationResult
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record
from drcli.store.remedies import remedy_of

NO_MILESTONES = Milestones()


def read_milestones(bucket: Bucket, prefix: str) -> Milestones | None:
    """None if missing, as in version 0.1.0 (see `with_history`).

    Raises:
        ObjectDamaged: It is unreadable.
    """
    key = keys.milestones(prefix)
    try:
        return read_record(bucket, key, Milestones.decode, remedy_of(key))
    except ObjectMissing:
        return None


def write_milestones(bucket: Bucket, prefix: str, milestones: Milestones) -> None:
    bucket.put(keys.milestones(prefix), milestones.encode())


def with_history(known: Milestones, records: Iterable[IterationRecord]) -> Milestones:
    before: IterationRecord | None = None
    for record in records:
        if record.stage if before is None else not record.compares_with(before):
            known = known.of_stage(record.iteration)
        before = record
        known = known.with_evaluation(
            _evaluated(record), record.evaluation_progress, record.evaluation_lap_s
        )
    return known


def _evaluated(record: IterationRecord) -> str:
    """Where driving and learning overlap, an earlier checkpoint drove."""
    if checkpoint_name(record.checkpoint).number == record.iteration:
        return record.checkpoint
    return str(CheckpointName(record.iteration, max(0, record.total_steps - record.steps)))


def with_results(known: Milestones, results: Iterable[EvaluationResult]) -> Milestones:
    for result in results:
        known = known.with_evaluation(result.checkpoint, result.progress, result.lap_s)
    return known


def readable_milestones(
    bucket: Bucket, prefix: str, records: Iterable[IterationRecord]
) -> tuple[Milestones, list[str]]:
    """For readers that never write, filled in from the learning curve; and a sentence on damage."""
    damaged: list[str] = []
    try:
        known = read_milestones(bucket, prefix)
    except ObjectDamaged as error:
        known, damaged = None, [f"{error} {error.remedy}"]
    return with_history(known or NO_MILESTONES, records), damaged

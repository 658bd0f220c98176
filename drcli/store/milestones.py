"""Reads and writes the milestones of a model, and works them out from its evaluations."""

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
    """The record of the milestones, None if there is none; ObjectDamaged if it is unreadable.

    Models of version 0.1.0 have no record; `with_history` works their milestones out.
    """
    key = keys.milestones(prefix)
    try:
        return read_record(bucket, key, Milestones.decode, remedy_of(key))
    except ObjectMissing:
        return None


def write_milestones(bucket: Bucket, prefix: str, milestones: Milestones) -> None:
    """Write `milestones.json`."""
    bucket.put(keys.milestones(prefix), milestones.encode())


def with_history(known: Milestones, records: Iterable[IterationRecord]) -> Milestones:
    """The milestones with all evaluations of the learning curve."""
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
    """Name of the checkpoint of an iteration's evaluation.

    Where driving and learning overlap, the checkpoint before it drove the iteration.
    """
    if checkpoint_name(record.checkpoint).number == record.iteration:
        return record.checkpoint
    return str(CheckpointName(record.iteration, max(0, record.total_steps - record.steps)))


def with_results(known: Milestones, results: Iterable[EvaluationResult]) -> Milestones:
    """The milestones with these evaluations, of which the learning curve may not know yet."""
    for result in results:
        known = known.with_evaluation(result.checkpoint, result.progress, result.lap_s)
    return known


def readable_milestones(
    bucket: Bucket, prefix: str, records: Iterable[IterationRecord]
) -> tuple[Milestones, list[str]]:
    """The milestones for a reader that writes nothing, and a sentence if they are damaged.

    `records` is the learning curve, which fills in what the record lacks.
    """
    damaged: list[str] = []
    try:
        known = read_milestones(bucket, prefix)
    except ObjectDamaged as error:
        known, damaged = None, [f"{error} {error.remedy}"]
    return with_history(known or NO_MILESTONES, records), damaged

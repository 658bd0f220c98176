"""The learning curve of a model: one record for each iteration, in one object."""

from collections.abc import Sequence
from dataclasses import replace

from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.iteration import IterationRecord, decode_history, encode_history
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing, read_record

_SMOOTH = 3
"""Iterations over which completion is averaged, because it varies by chance."""

_PEAK = 40.0
"""Mean completion, percent; a policy that was never so good cannot collapse."""

_FALL = 0.6
"""Share of the best completion below which the policy has collapsed."""


class History:
    """All iterations of a model. Only the trainer writes it."""

    def __init__(self, bucket: Bucket, prefix: str) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self.records = read_history(bucket, prefix)

    def restore(self, iteration: int, last: IterationRecord | None) -> None:
        """Go back to the time when a checkpoint was published.

        Args:
            iteration: Its number; this iteration and later ones are dropped and repeated.
            last: The record before, from the checkpoint, which is published before the history: a
                trainer may have ended between the two.
        """
        self.records = [r for r in self.records if r.iteration < iteration]
        if last is not None and last.iteration not in {r.iteration for r in self.records}:
            self.add(last)

    def add(self, record: IterationRecord) -> None:
        """Append an iteration and publish."""
        self.records.append(record)
        write_history(self._bucket, self._prefix, self.records)

    def add_evaluation(self, iteration: int, progress: list[float], lap_s: list[float]) -> None:
        """Add the evaluation of a checkpoint, and publish."""
        self.records = [
            replace(r, evaluation_progress=progress, evaluation_lap_s=lap_s)
            if r.iteration == iteration
            else r
            for r in self.records
        ]
        write_history(self._bucket, self._prefix, self.records)


def read_history(bucket: Bucket, prefix: str) -> list[IterationRecord]:
    """All iterations so far, oldest first; ObjectDamaged if it is unreadable."""
    remedy = (
        "Stop the training and continue with `dr-start-training --resume`, which reconstructs it."
    )
    try:
        return read_record(bucket, keys.history(prefix), decode_history, remedy)
    except ObjectMissing:
        return []


def write_history(bucket: Bucket, prefix: str, records: Sequence[IterationRecord]) -> None:
    """Publish all iterations, oldest first."""
    bucket.put(keys.history(prefix), encode_history(records))


def collapse(records: Sequence[IterationRecord], best: str | None) -> str | None:
    """A sentence if the policy has become far worse than it was, None if not.

    Args:
        records: The iterations so far, oldest first.
        best: Name of the best checkpoint.
    """
    progress = [record.mean_progress for record in records]
    means = [
        sum(progress[end - _SMOOTH : end]) / _SMOOTH for end in range(_SMOOTH, len(progress) + 1)
    ]
    if not means or max(means) < _PEAK or means[-1] > _FALL * max(means):
        return None
    name = CheckpointName.parse(best or "")
    where = "" if name is None else f"; best is {name.number}"
    return f"completion fell from {max(means):.0f} % to {means[-1]:.0f} %{where}"

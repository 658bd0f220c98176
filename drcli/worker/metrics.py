"""TrainingMetrics.json of one simulation worker, which goes on where an earlier process left it."""

import contextlib
from collections.abc import Sequence
from typing import Any

from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.training_metrics import read_records, write_records
from drcli.worker.trace import Episode, training_record


class TrainingMetrics:
    """All episodes a worker has driven, in the order in which they lie on its clock.

    Raises:
        ObjectDamaged: What is there is something else.
    """

    def __init__(self, bucket: Bucket, key: str, best_model_metric: str) -> None:
        self._bucket = bucket
        self._key = key
        self._best_model_metric = best_model_metric
        self._records: list[dict[str, Any]] = []
        with contextlib.suppress(ObjectMissing):
            self._records = read_records(bucket, key)

    @property
    def clock_s(self) -> float:
        """Simulation clock after the last episode, seconds."""
        return max((r["metric_time"] for r in self._records), default=0) / 1000.0

    def keep_before(self, first_episode: int) -> None:
        """Forget training episodes from this number (from 0) on, and their evaluations."""
        self._records = [r for r in self._records if r["episode"] <= first_episode]

    def add(self, training: Sequence[Episode], evaluation: Sequence[Episode] = ()) -> None:
        """Append one iteration's episodes and publish the file.

        Args:
            training: In the order of their numbers.
            evaluation: Of the checkpoint that drove them; their records carry the number of the
                last training episode.
        """
        for trial, episode in enumerate(training, start=1):
            self._records.append(training_record(episode, episode.number + 1, trial))
        last = next(
            (r for r in reversed(self._records) if r["phase"] == "training"),
            {"episode": 1, "trial": 1},
        )
        self._records += [
            training_record(episode, last["episode"], last["trial"]) for episode in evaluation
        ]
        if not self._records:
            return
        write_records(self._bucket, self._key, self._records, self._best_model_metric)

"""Writes TrainingMetrics.json of one simulation worker, and continues the file after a restart."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace

from drcli.exchange.episode_metrics import (
    EpisodeMetrics,
    encode_metrics,
    most_episodes,
)
from drcli.exchange.trace import Episode
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.repair import read_metrics
from drcli.workers.episode_share import Share


class TrainingMetrics:
    """All episodes that a worker has driven, in the order of its simulated clock.

    To find the iteration of an episode, analysis tools divide its number by the most episodes that
    worker 0 drove in one iteration, in the files of all workers. So a worker that drives 6 episodes
    while another drives 7 leaves out one number of each iteration. Each record also has its
    iteration in a key that those tools ignore, so a resume with more episodes can renumber all.

    The file also names the metric of the best model, DR_TRAIN_BEST_MODEL_METRIC.

    Raises:
        ObjectDamaged: The file in the bucket is damaged.
    """

    def __init__(
        self, bucket: Bucket, metrics_prefix: str, best_model_metric: str, share: Share
    ) -> None:
        self._bucket = bucket
        self._key = keys.training_metrics(metrics_prefix, share.worker)
        self._best_model_metric = best_model_metric
        records: list[EpisodeMetrics] = []
        with contextlib.suppress(ObjectMissing):
            records = _with_iterations(read_metrics(bucket, self._key))
        self._per_iteration = max(share.most, most_episodes(records))
        if share.worker > 0:
            with contextlib.suppress(ObjectMissing, ObjectDamaged):
                first = read_metrics(bucket, keys.training_metrics(metrics_prefix, 0))
                self._per_iteration = max(self._per_iteration, most_episodes(first))
        self._records = [
            replace(record, episode=self._number(record.iteration or 0, record.trial))
            for record in records
        ]

    @property
    def clock_s(self) -> float:
        """Simulation clock after the last episode, seconds."""
        return max((r.metric_time for r in self._records), default=0) / 1000.0

    def keep_before(self, iteration: int) -> None:
        """Remove the episodes and evaluations of this iteration and of later ones."""
        self._records = [r for r in self._records if (r.iteration or 0) < iteration]

    def add(
        self, iteration: int, training: Sequence[Episode], evaluation: Sequence[Episode] = ()
    ) -> None:
        """Append one iteration's training and evaluation episodes, in order, and publish the file.

        Evaluation episodes get the number of the iteration's last training episode.
        """
        for trial, episode in enumerate(training, start=1):
            self._add(episode, iteration, trial)
        last = max((r.trial for r in self._records if r.iteration == iteration), default=1)
        for episode in evaluation:
            self._add(episode, iteration, last)
        if self._records:
            self._bucket.put(self._key, encode_metrics(self._records, self._best_model_metric))

    def _add(self, episode: Episode, iteration: int, trial: int) -> None:
        number = self._number(iteration, trial)
        self._records.append(
            EpisodeMetrics.of(episode, iteration=iteration, episode=number, trial=trial)
        )

    def _number(self, iteration: int, trial: int) -> int:
        return iteration * self._per_iteration + trial


def _with_iterations(records: Sequence[EpisodeMetrics]) -> list[EpisodeMetrics]:
    """The records with their iterations, which version 0.1.0 did not write."""
    found, iteration = [], -1
    for record in records:
        iteration += record.phase == "training" and record.trial == 1
        if record.iteration is not None:
            iteration = record.iteration
        found.append(replace(record, iteration=max(iteration, 0)))
    return found

"""Publishes metrics, traces and figures of one worker's episodes."""

import time
from collections.abc import Sequence
from contextlib import suppress

from drcli.base.log import get_logger, traces
from drcli.exchange.checkpoint import CheckpointName, checkpoint_name
from drcli.exchange.episode_metrics import EpisodeMetrics
from drcli.exchange.job import Job
from drcli.exchange.scores import EvaluationResult
from drcli.exchange.trace import csv_text, schedule, steering_changes
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.rollbacks import read_rollbacks
from drcli.store.trace_retention import TraceRetention
from drcli.tracking.figure_events import episode_points
from drcli.tracking.open_sinks import sender_of_episodes
from drcli.workers import reference_log
from drcli.workers.cores import max_lag
from drcli.workers.driven_episode import Driven, columns_of
from drcli.workers.metrics_file import TrainingMetrics
from drcli.workers.training_simulation import TrainingSimulation

_logger = get_logger(__name__)

_MOVED_AT_ONCE = 50
"""While the trainer learns; a move is three requests."""


class DriveResults:
    """Results in the order of the simulated clock.

    Log-guru stops at an episode that it has seen, so the log gets each one once.

    Raises:
        ObjectDamaged: The metrics in the bucket are damaged.
    """

    def __init__(self, job: Job, bucket: Bucket, simulation: TrainingSimulation) -> None:
        self._config = job.config
        self._bucket = bucket
        self._prefix = job.config.model.prefix
        self._worker = simulation.share.worker
        self._lag = max_lag(job.config.train)
        self._figures = sender_of_episodes(job.config.figures, self._prefix)
        self._simulation = simulation
        self._metrics = self._open_metrics()
        self._traces = TraceRetention(bucket, self._prefix, job.config.train.workers, 0)
        self._traces.cover(self._worker)
        is_first = self._worker == 0
        self._alone = is_first and job.config.train.workers == 1 and not self._stored(workers=2)
        self._behind = self._stored(workers=1) if is_first and not self._alone else []
        self._logged = -1
        self._driven_before = False
        self._evaluated_before = False

    def enter(self, simulation: TrainingSimulation) -> None:
        self._simulation = simulation
        self._metrics.finish()
        self._metrics = self._open_metrics()

    def _open_metrics(self) -> TrainingMetrics:
        model, stage = self._config.model, self._simulation.stage
        return TrainingMetrics(
            self._bucket,
            model.metrics_prefix,
            model.metric,
            self._simulation.share,
            stage="" if stage is None else stage.name,
        )

    def forget_given_up(self, newest: CheckpointName | None = None) -> None:
        """Note what the log has, and delete traces of iterations given up."""
        try:
            rollbacks = read_rollbacks(self._bucket, self._prefix)
        except ObjectDamaged:
            return
        left = [checkpoint_name(each.left).number for each in rollbacks.entries]
        self._logged = max(left, default=-1 - self._lag) + self._lag
        if left and newest is not None:
            self._traces.delete_after(newest.number + self._lag)

    def keep_before(self, iteration: int) -> None:
        """This iteration and later ones are driven again."""
        self._metrics.keep_before(iteration)

    def publish_training(
        self,
        iteration: int,
        name: CheckpointName,
        episodes: list[Driven],
        wall_clock: tuple[float, float],
    ) -> None:
        """Publish the training episodes of an iteration.

        Args:
            iteration: Its number.
            name: The checkpoint that drove.
            episodes: All of this worker; they are sorted, and get their times.
            wall_clock: Unix times of the beginning and the end of the drive, seconds.
        """
        episodes.sort(key=lambda episode: episode.number)
        schedule(episodes, self._metrics.clock_s)
        self._send_figures(self._metrics.add(iteration, episodes), wall_clock)
        length_m, worker = self._simulation.track_length_m, self._worker
        assigned = self._simulation.assigned
        if self._alone and assigned is not None and len(assigned.shares.workers) > 1:
            self._alone, self._behind = False, self._stored(workers=1)
        workers = 1 if self._alone else 2
        key = keys.training_trace(self._prefix, iteration, worker=worker, workers=workers)
        self._driven_before = iteration <= self._logged or self._bucket.exists(key)
        if not self._driven_before:  # else the log has them already
            traces.info(
                reference_log.training_lines(
                    episodes, worker, length_m, name.steps, iteration, wall_clock[1]
                )
            )
        self._bucket.put(key, csv_text(episodes, length_m, wall_clock).encode())

    def gather(self) -> None:
        """Move some traces to the folder for the present number of workers.

        Tools of others read the traces of one worker or of several, but not both.
        """
        moved, self._behind = self._behind[:_MOVED_AT_ONCE], self._behind[_MOVED_AT_ONCE:]
        folder = keys.training_traces_folder(self._prefix, 0, 2)
        for key in moved:
            target = folder + key.rpartition("/")[2]
            with suppress(ObjectMissing):  # there may have been too many
                if not self._bucket.exists(target):
                    self._bucket.put(target, self._bucket.get(key))
            self._bucket.delete([key])

    def _stored(self, workers: int) -> list[str]:
        folder = keys.training_traces_folder(self._prefix, self._worker, workers)
        return [info.key for info in self._bucket.list(folder)]

    def score(
        self, name: CheckpointName, episodes: list[Driven], rollbacks: int
    ) -> EvaluationResult | None:
        """The results of all trials, sorted; None if all were declared broken."""
        episodes.sort(key=lambda episode: episode.number)
        key = keys.evaluation_result(self._prefix, name.number)
        self._evaluated_before = name.number <= self._logged or self._bucket.exists(key)
        sound = [episode for episode in episodes if not episode.discarded]
        if not sound:
            _logger.warning(
                "Checkpoint %d is not scored: the reward function declared all episodes of its "
                "evaluation broken.",
                name.number,
            )
            return None
        changes, metres = steering_changes(sound)
        return EvaluationResult(
            str(name),
            *columns_of(sound),
            steering_per_m=changes / metres if metres > 1.0 else None,
            rollbacks=rollbacks,
        )

    def publish_evaluation(
        self,
        iteration: int,
        name: CheckpointName,
        episodes: list[Driven],
        last_episode: int,
        begin: float,
    ) -> None:
        """After the training episodes of its drive.

        Args:
            iteration: Driven at the same time.
            name: The checkpoint.
            episodes: All trials, after `score`.
            last_episode: One more than the number of the iteration's last training episode.
            begin: Of the drive, Unix seconds.
        """
        schedule(episodes, self._metrics.clock_s)
        self._send_figures(self._metrics.add(iteration, [], episodes), (begin, time.time()))
        if not (self._driven_before and self._evaluated_before):  # else the log has it already
            traces.info(
                reference_log.evaluation_lines(
                    episodes, self._worker, last_episode, name.steps, name.number
                )
            )

    def close(self) -> None:
        self._metrics.finish()
        self._figures.close()

    def _send_figures(
        self, records: Sequence[EpisodeMetrics], wall_clock: tuple[float, float]
    ) -> None:
        if self._figures.is_active:
            self._figures.send(*episode_points(records, self._worker, wall_clock))

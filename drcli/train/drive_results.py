"""Publishes metrics, traces and figures of one worker's episodes."""

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from drcli.base.log import get_logger, traces
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.drive import reference_log
from drcli.drive.driving import Driven, columns_of
from drcli.metrics.figure_events import episode_points
from drcli.metrics.open_sinks import sender_of_episodes
from drcli.model import keys
from drcli.model.growing_file import GrowingFile, Layout, list_parts, read_all_metrics
from drcli.model.model_store import ModelStore
from drcli.model.traces import TraceRetention
from drcli.model.training_state import read_rollbacks
from drcli.records.checkpoint import CheckpointName, checkpoint_name
from drcli.records.episode_metrics import (
    METRICS_HEAD,
    SEPARATOR,
    EpisodeMetrics,
    encode_records,
    metrics_end,
    most_episodes,
)
from drcli.records.job import Job
from drcli.records.scores import EvaluationResult
from drcli.records.trace import Episode, csv_text, schedule, steering_changes
from drcli.train.episode_share import Share
from drcli.train.training_simulation import TrainingSimulation
from drcli.workers.cores import max_lag

# Writes TrainingMetrics.json of one worker, and continues it after a restart.


ITERATIONS_PER_PART = 16


class TrainingMetrics:
    """All episodes of a worker, in the order of its simulated clock.

    Analysis tools divide an episode's number by the most episodes that worker 0 drove in one
    iteration, in the files of all workers. So a worker that drives 6 episodes while another
    drives 7 leaves out a number. Each record also has its iteration and `stage` in keys that
    those tools ignore, so a resume with more episodes can renumber all.

    Raises:
        ObjectDamaged: The file in the bucket is damaged.
    """

    def __init__(self, model: ModelStore, share: Share, *, stage: str = "") -> None:
        self._stage = stage
        bucket = model.bucket
        key = keys.training_metrics(model.metrics_prefix, share.worker)
        layout = Layout(METRICS_HEAD, SEPARATOR, metrics_end(model.metric))
        self._file = GrowingFile(bucket, key, layout, iterations_per_part=ITERATIONS_PER_PART)
        parts = list_parts(bucket, key)
        found = read_all_metrics(bucket, key)
        records = _with_iterations(found)
        self._per_iteration = max(share.most, most_episodes(records))
        if share.worker > 0:
            with suppress(ObjectDamaged):
                first = read_all_metrics(bucket, keys.training_metrics(model.metrics_prefix, 0))
                self._per_iteration = max(self._per_iteration, most_episodes(first))
        records = [
            replace(record, episode=self._number(record.iteration or 0, record.trial))
            for record in records
        ]
        # Of each iteration: the clock at its end in milliseconds, and its last trial.
        self._ends: dict[int, tuple[float, int]] = {}
        self._clock_ms = 0.0
        driven: dict[int, list[EpisodeMetrics]] = {}
        for record in records:
            driven.setdefault(record.iteration or 0, []).append(record)
        for iteration, of_iteration in driven.items():
            self._note(iteration, of_iteration)
        entries = [(iteration, encode_records(own)) for iteration, own in sorted(driven.items())]
        self._file.restore(entries, parts, outdated=records != found)

    @property
    def clock_s(self) -> float:
        return self._clock_ms / 1000.0

    def keep_before(self, iteration: int) -> None:
        kept = {number: end for number, end in self._ends.items() if number < iteration}
        if len(kept) < len(self._ends):
            self._file.drop_from(iteration)
            self._ends = kept
            self._clock_ms = max((end_ms for end_ms, _ in kept.values()), default=0.0)

    def add(
        self, iteration: int, training: Sequence[Episode], evaluation: Sequence[Episode] = ()
    ) -> list[EpisodeMetrics]:
        """Evaluation episodes get the number of the last training episode."""
        records = [
            self._record(episode, iteration, trial)
            for trial, episode in enumerate(training, start=1)
        ]
        _, before = self._ends.get(iteration, (0.0, 1))
        last = max([before, *(r.trial for r in records)])
        records += [self._record(episode, iteration, last) for episode in evaluation]
        if records:
            self._note(iteration, records)
            written = self._file.entry(iteration)
            text = encode_records(records)
            self._file.put(iteration, text if written is None else written + SEPARATOR + text)
        return records

    def finish(self) -> None:
        self._file.finish()

    def _note(self, iteration: int, records: Sequence[EpisodeMetrics]) -> None:
        end_ms, trial = self._ends.get(iteration, (0.0, 1))
        end_ms = max([end_ms, *(record.metric_time for record in records)])
        self._ends[iteration] = end_ms, max([trial, *(record.trial for record in records)])
        self._clock_ms = max(self._clock_ms, end_ms)

    def _record(self, episode: Episode, iteration: int, trial: int) -> EpisodeMetrics:
        number = self._number(iteration, trial)
        record = EpisodeMetrics.of(episode, iteration=iteration, episode=number, trial=trial)
        return replace(record, stage=self._stage) if self._stage else record

    def _number(self, iteration: int, trial: int) -> int:
        return iteration * self._per_iteration + trial


def _with_iterations(records: Sequence[EpisodeMetrics]) -> list[EpisodeMetrics]:
    """Version 0.1.0 did not write them."""
    found, iteration = [], -1
    for record in records:
        iteration += record.phase == "training" and record.trial == 1
        if record.iteration is not None:
            iteration = record.iteration
        found.append(replace(record, iteration=max(iteration, 0)))
    return found


_logger = get_logger(__name__)

_MOVED_AT_ONCE = 50
"""While the trainer learns; a move is three requests."""


class DriveResults:
    """Results in the order of the simulated clock.

    Log-guru stops at an episode that it has seen, so the log gets each one once.

    Raises:
        ObjectDamaged: The metrics in the bucket are damaged.
    """

    def __init__(self, job: Job, model: ModelStore, simulation: TrainingSimulation) -> None:
        self._bucket = model.bucket
        self._prefix = model.prefix
        self._model = model
        self._worker = simulation.share.worker
        self._lag = max_lag(job.config.train)
        self._figures = sender_of_episodes(job.config.figures, self._prefix)
        self._simulation = simulation
        self._metrics = self._open_metrics()
        self._traces = TraceRetention(model, job.config.train.workers, 0)
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
        stage = self._simulation.stage
        name = "" if stage is None else stage.name
        return TrainingMetrics(self._model, self._simulation.share, stage=name)

    def forget_given_up(self, newest: CheckpointName | None = None) -> None:
        """Note what the log has, and delete traces of iterations given up."""
        try:
            rollbacks = read_rollbacks(self._model)
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
        worker = self._worker
        records = self._metrics.add(iteration, episodes)
        self._figures.send(*episode_points(records, worker, wall_clock))
        assigned = self._simulation.assigned
        if self._alone and assigned is not None and len(assigned.shares.workers) > 1:
            self._alone, self._behind = False, self._stored(workers=1)
        workers = 1 if self._alone else 2
        key = keys.training_trace(self._prefix, iteration, worker=worker, workers=workers)
        self._driven_before = iteration <= self._logged or self._bucket.exists(key)
        if not self._driven_before:  # else the log has them already
            traces.info(
                reference_log.training_lines(episodes, worker, name.steps, iteration, wall_clock[1])
            )
        self._bucket.put(key, csv_text(episodes, wall_clock).encode())

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
        records = self._metrics.add(iteration, [], episodes)
        self._figures.send(*episode_points(records, self._worker, (begin, time.time())))
        if not (self._driven_before and self._evaluated_before):  # else the log has it already
            traces.info(
                reference_log.evaluation_lines(
                    episodes, self._worker, last_episode, name.steps, name.number
                )
            )

    def close(self) -> None:
        self._metrics.finish()
        self._figures.close()

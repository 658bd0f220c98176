"""Writes TrainingMetrics.json of one worker, and continues it after a restart."""

import contextlib
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby

from drcli.exchange.episode_metrics import (
    METRICS_HEAD,
    SEPARATOR,
    EpisodeMetrics,
    encode_records,
    metrics_end,
    most_episodes,
)
from drcli.exchange.trace import Episode
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged
from drcli.store.growing_file import GrowingFile, Layout, list_parts
from drcli.store.repair import read_all_metrics
from drcli.workers.episode_share import Share

ITERATIONS_PER_PART = 16

NOTES = 2


class TrainingMetrics:
    """All episodes of a worker, in the order of its simulated clock.

    Analysis tools divide an episode's number by the most episodes that worker 0 drove in one
    iteration, in the files of all workers. So a worker that drives 6 episodes while another
    drives 7 leaves out a number. Each record also has its iteration and `stage` in keys that
    those tools ignore, so a resume with more episodes can renumber all.

    Raises:
        ObjectDamaged: The file in the bucket is damaged.
    """

    def __init__(
        self,
        bucket: Bucket,
        metrics_prefix: str,
        best_model_metric: str,
        share: Share,
        *,
        stage: str = "",
    ) -> None:
        self._stage = stage
        key = keys.training_metrics(metrics_prefix, share.worker)
        layout = Layout(METRICS_HEAD, SEPARATOR, metrics_end(best_model_metric))
        self._file = GrowingFile(bucket, key, layout, iterations_per_part=ITERATIONS_PER_PART)
        parts = list_parts(bucket, key)
        found = read_all_metrics(bucket, key)
        records = _with_iterations(found)
        self._per_iteration = max(share.most, most_episodes(records))
        if share.worker > 0:
            with contextlib.suppress(ObjectDamaged):
                first = read_all_metrics(bucket, keys.training_metrics(metrics_prefix, 0))
                self._per_iteration = max(self._per_iteration, most_episodes(first))
        records = [
            replace(record, episode=self._number(record.iteration or 0, record.trial))
            for record in records
        ]
        # Of each iteration: its number, the clock at its end in milliseconds, its last trial.
        self._iterations = array("q")
        self._ends_ms = array("d")
        self._trials = array("q")
        self._clock_ms, self._newest = 0.0, -1
        entries = []
        for iteration, group in groupby(records, lambda record: record.iteration or 0):
            of_iteration = list(group)
            self._note(iteration, of_iteration)
            entries.append((iteration, encode_records(of_iteration)))
        self._file.restore(_joined(entries), parts, outdated=records != found)

    @property
    def clock_s(self) -> float:
        return self._clock_ms / 1000.0

    def keep_before(self, iteration: int) -> None:
        if self._newest < iteration:
            return
        self._file.drop_from(iteration)
        kept = [at for at, number in enumerate(self._iterations) if number < iteration]
        self._iterations = array("q", (self._iterations[at] for at in kept))
        self._ends_ms = array("d", (self._ends_ms[at] for at in kept))
        self._trials = array("q", (self._trials[at] for at in kept))
        self._clock_ms = max(self._ends_ms, default=0.0)
        self._newest = max(self._iterations, default=-1)

    def add(
        self, iteration: int, training: Sequence[Episode], evaluation: Sequence[Episode] = ()
    ) -> list[EpisodeMetrics]:
        """Evaluation episodes get the number of the last training episode."""
        records = [
            self._record(episode, iteration, trial)
            for trial, episode in enumerate(training, start=1)
        ]
        newest = zip(self._iterations[-NOTES:], self._trials[-NOTES:], strict=True)
        trials = [trial for number, trial in newest if number == iteration]
        last = max([*trials, *(r.trial for r in records)], default=1)
        records += [self._record(episode, iteration, last) for episode in evaluation]
        if records:
            self._note(iteration, records)
            before = self._file.entry(iteration)
            text = encode_records(records)
            self._file.put(iteration, text if before is None else before + SEPARATOR + text)
        return records

    def finish(self) -> None:
        self._file.finish()

    def _note(self, iteration: int, records: Sequence[EpisodeMetrics]) -> None:
        self._iterations.append(iteration)
        self._ends_ms.append(max(record.metric_time for record in records))
        self._trials.append(max(record.trial for record in records))
        self._clock_ms = max(self._clock_ms, self._ends_ms[-1])
        self._newest = max(self._newest, iteration)

    def _record(self, episode: Episode, iteration: int, trial: int) -> EpisodeMetrics:
        number = self._number(iteration, trial)
        record = EpisodeMetrics.of(episode, iteration=iteration, episode=number, trial=trial)
        return replace(record, stage=self._stage) if self._stage else record

    def _number(self, iteration: int, trial: int) -> int:
        return iteration * self._per_iteration + trial


def _joined(entries: Iterable[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    found: dict[int, bytes] = {}
    for iteration, entry in entries:
        found[iteration] = found[iteration] + SEPARATOR + entry if iteration in found else entry
    return sorted(found.items())


def _with_iterations(records: Sequence[EpisodeMetrics]) -> list[EpisodeMetrics]:
    """Version 0.1.0 did not write them."""
    found, iteration = [], -1
    for record in records:
        iteration += record.phase == "training" and record.trial == 1
        if record.iteration is not None:
            iteration = record.iteration
        found.append(replace(record, iteration=max(iteration, 0)))
    return found

"""The auditor: proves from the bucket alone that nothing was lost, doubled or left damaged."""

import csv
import io
import itertools
import json
import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

from drcli.base.errors import DrError
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record
from drcli.model import keys
from drcli.model.best_checkpoint import read_scores
from drcli.model.checkpoints import CheckpointStore
from drcli.model.growing_file import read_all_metrics, read_complete
from drcli.model.history import read_history
from drcli.model.model_prefix import ModelListing
from drcli.model.model_store import ModelStore
from drcli.model.repair import model_objects
from drcli.records.episode_metrics import EpisodeMetrics
from drcli.records.iteration import IterationRecord
from drcli.records.trace import STATUS_LABELS, TracedEpisode, read_csv

LOOK_AGAIN_S = 1.5
"""When to look again at a model that is being trained: rclone deletes an old object a moment before
it gives the new one its name, and this audit reads the files."""

REWARD_ERROR = 0.02
"""Relative: the trace has float64 sums, the rollout float32 rewards."""


@dataclass
class Audit:
    """One look at a model.

    Args:
        bucket: With the model.
        prefix: Of the model.
        workers: DR_WORKERS.
        damaged: Keys that a fault has damaged and that nobody may have repaired yet.
        ended: Whether the training has reached its end; nothing may be open then.
    """

    bucket: Bucket
    prefix: str
    workers: int
    damaged: Collection[str] = ()
    ended: bool = False
    findings: list[str] = field(default_factory=list)

    def run(self) -> list[str]:
        """All findings, empty if the model is as it should be."""
        try:
            history = read_history(ModelStore(self.bucket, self.prefix))
        except ObjectDamaged as error:
            if keys.history(self.prefix) not in self.damaged or self.ended:
                self.findings.append(str(error))
            return self.findings
        self._check_objects()
        self._check_counters(history)
        self._check_rows(history)
        self._check_learner_rows(history)
        if self.ended:
            self._check_end(history)
        return self.findings

    def _check(self, holds: bool, sentence: str) -> None:
        if not holds:
            self.findings.append(sentence)

    def _check_objects(self) -> None:
        """Every object is readable, or its damage is named."""
        metrics = keys.metrics_prefix(self.prefix)
        model = ModelStore(self.bucket, self.prefix, metrics, workers=range(self.workers))
        for item in model_objects(ModelListing(model)):
            try:
                read_record(self.bucket, item.key, item.decode)
            except ObjectMissing:
                continue
            except ObjectDamaged as error:
                if self.ended or item.key not in self.damaged:
                    self.findings.append(str(error))
        for info in self.bucket.list(keys.folder(self.prefix)):
            if info.key in self.damaged or not info.key.endswith((".json", ".jsonl")):
                continue
            try:
                text = self.bucket.get(info.key).decode()
                for part in text.splitlines() if info.key.endswith(".jsonl") else [text]:
                    json.loads(part)
            except ObjectMissing:
                continue  # deleted meanwhile
            except ValueError as error:
                self.findings.append(f"{info.key} is no JSON: {error}.")

    def _check_counters(self, history: Sequence[IterationRecord]) -> None:
        """Iterations follow each other, and what is counted only grows."""
        numbers = [record.iteration for record in history]
        self._check(numbers == list(range(len(numbers))), f"The history has iterations {numbers}.")
        steps, before_s = 0, 0.0
        for record in history:
            steps += record.steps
            where = f"Iteration {record.iteration} of the history"
            self._check(
                record.total_steps == steps,
                f"{where} has {record.total_steps} steps in total, the sum is {steps}.",
            )
            # After a reconstruction, a trace's times stand in for the trainer's.
            self._check(
                record.elapsed_s >= 0.0 and math.isfinite(record.elapsed_s),
                f"{where} has elapsed {record.elapsed_s} s.",
            )
            if not math.isnan(record.learn_s):
                self._check(
                    record.elapsed_s >= before_s - 1.0,
                    f"{where} has elapsed {record.elapsed_s:.1f} s after {before_s:.1f} s.",
                )
                before_s = record.elapsed_s

    def _check_rows(self, history: Sequence[IterationRecord]) -> None:
        """History, traces and metrics tell the same of each finished iteration."""
        traced = ModelListing(ModelStore(self.bucket, self.prefix)).traces
        metrics: dict[int, list[EpisodeMetrics]] = {}
        for worker in range(self.workers):
            key = keys.training_metrics(keys.metrics_prefix(self.prefix), worker)
            try:
                metrics[worker] = read_all_metrics(self.bucket, key)
            except ObjectDamaged:
                continue  # a finding of `_check_objects`
            self._check_order(worker, metrics[worker])
        finished = history if self.ended else history[:-1]
        for record in finished:
            found = traced.get(record.iteration, {})
            if any(key in self.damaged for key in found.values()):
                continue
            episodes = {worker: read_csv(self.bucket.get(key)) for worker, key in found.items()}
            self._check(
                _fits(record, episodes),
                f"Iteration {record.iteration}: the history has {record.episodes} episodes with "
                f"{record.steps} steps, mean reward {record.mean_reward:.2f}, but the traces have "
                f"{_brief(episodes)}.",
            )
            for worker, driven in episodes.items():
                if worker in metrics:
                    rows = [r for r in metrics[worker] if r.iteration == record.iteration]
                    self._check_metrics(record.iteration, worker, driven, rows)

    def _check_metrics(
        self,
        iteration: int,
        worker: int,
        driven: Sequence[TracedEpisode],
        rows: Sequence[EpisodeMetrics],
    ) -> None:
        where = f"Iteration {iteration} of worker {worker}"
        training = [r for r in rows if r.phase == "training"]
        trials = [r.trial for r in training]
        self._check(
            trials == list(range(1, len(driven) + 1)),
            f"{where}: the trace has {len(driven)} episodes, the metrics have trials {trials}.",
        )
        for row, episode in zip(training, driven, strict=False):
            same = (
                abs(row.reward_score - episode.reward) <= 0.51
                and row.completion_percentage == min(100, max(0, int(episode.progress)))
                and row.episode_status == STATUS_LABELS[episode.status]
            )
            self._check(same, f"{where}: metrics {row} are not those of the trace {episode}.")
        evaluated = sum(r.phase == "evaluation" for r in rows)
        self._check(evaluated <= 1, f"{where} has {evaluated} evaluation episodes instead of one.")

    def _check_order(self, worker: int, rows: Sequence[EpisodeMetrics]) -> None:
        """No episode comes twice, and the simulation clock only grows."""
        training = [r.episode for r in rows if r.phase == "training"]
        self._check(
            len(training) == len(set(training)),
            f"The metrics of worker {worker} have episodes twice: {_doubled(training)}.",
        )
        self._check(
            training == sorted(training),
            f"The metrics of worker {worker} have episodes out of order.",
        )
        times = [r.metric_time for r in rows]
        falls = sum(b < a for a, b in itertools.pairwise(times))
        self._check(falls == 0, f"The simulation clock of worker {worker} goes back {falls} times.")

    def _check_learner_rows(self, history: Sequence[IterationRecord]) -> None:
        """`learner.csv` has a row for each iteration, with the numbers of the history."""
        key = keys.learner_metrics(self.prefix)
        if key in self.damaged and not self.ended:
            return
        try:
            text = read_complete(self.bucket, key).decode()
            rows = {int(r["iteration"]): r for r in csv.DictReader(io.StringIO(text))}
            lines = len(text.splitlines()) - 1
        except ObjectMissing:
            rows, lines = {}, 0
        except (ValueError, KeyError, TypeError) as error:
            self.findings.append(f"{key} cannot be read: {error!r}.")
            return
        self._check(lines == len(rows), f"{key} has {lines} rows of {len(rows)} iterations.")
        # It is written in the background, so while the training runs it may be one behind.
        for record in history if self.ended else history[:-2]:
            row = rows.get(record.iteration)
            if row is None:
                self.findings.append(f"{key} has no row of iteration {record.iteration}.")
                continue
            self._check(
                int(row["global_step"]) == record.total_steps
                and math.isclose(
                    float(row["charts/episodic_return"]), record.mean_reward, rel_tol=1e-4
                ),
                f"{key}: the row of iteration {record.iteration} is not that of the history.",
            )

    def _check_end(self, history: Sequence[IterationRecord]) -> None:
        """The last checkpoints can be loaded, and nothing of the exchange is left."""
        store = CheckpointStore(ModelStore(self.bucket, self.prefix))
        try:
            latest = store.load_latest(with_optimizer=True)
            best = store.best_name()
            if best is not None:
                store.load(best)
        except DrError as error:
            self.findings.append(str(error))
            return
        if latest is None:
            self.findings.append("There is no checkpoint.")
            return
        self._check(latest.damaged == (), f"Checkpoints are damaged: {latest.damaged}.")
        self._check(latest.optimizer is not None, "The last checkpoint has no optimizer state.")
        self._check(
            latest.record.number == len(history)
            and latest.record.counters.episodes == sum(r.episodes for r in history)
            and latest.record.steps == sum(r.steps for r in history),
            f"Checkpoint {latest.record.name} has learned from "
            f"{latest.record.counters.episodes} episodes, the history has "
            f"{sum(r.episodes for r in history)} with {sum(r.steps for r in history)} steps in "
            f"{len(history)} iterations.",
        )
        scores = read_scores(ModelStore(self.bucket, self.prefix))
        self._check(
            scores is not None and scores.last_checkpoint.name == latest.record.name,
            f"The scores do not name {latest.record.name} as the last checkpoint.",
        )
        left = [info.key for info in self.bucket.list(keys.rollouts_folder(self.prefix))]
        self._check(not left, f"Rollouts are left: {left[:3]}.")


def audit_twice(make: Callable[[], Audit]) -> list[str]:
    """What a first and a second look find; nothing else of a model that changes meanwhile."""
    found: list[str] = []
    for look in range(2):
        try:
            findings = make().run()
        except DrError as error:
            findings = [f"The audit failed: {error}"]
        found = [finding for finding in findings if look == 0 or finding in found]
        if not found:
            break
        time.sleep(LOOK_AGAIN_S if look == 0 else 0.0)
    return found


def _fits(record: IterationRecord, episodes: dict[int, list[TracedEpisode]]) -> bool:
    """Whether the episodes of all workers, or of some if others were late, made the record."""
    for size in range(len(episodes), 0, -1):
        for workers in itertools.combinations(sorted(episodes), size):
            driven = [episode for worker in workers for episode in episodes[worker]]
            if _is_of(record, driven):
                return True
    return False


def _is_of(record: IterationRecord, driven: Sequence[TracedEpisode]) -> bool:
    if len(driven) != record.episodes or sum(e.steps for e in driven) != record.steps:
        return False
    reward = sum(e.reward for e in driven) / len(driven)
    progress = sum(e.progress for e in driven) / len(driven)
    return math.isclose(
        reward, record.mean_reward, rel_tol=REWARD_ERROR, abs_tol=REWARD_ERROR
    ) and math.isclose(progress, record.mean_progress, rel_tol=REWARD_ERROR, abs_tol=0.05)


def _brief(episodes: dict[int, list[TracedEpisode]]) -> str:
    found = {w: [(e.steps, round(e.reward, 2)) for e in driven] for w, driven in episodes.items()}
    return f"(steps, reward) by worker {found}"


def _doubled(numbers: Sequence[int]) -> list[int]:
    return sorted({n for n in numbers if numbers.count(n) > 1})

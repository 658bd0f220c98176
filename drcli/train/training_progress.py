"""Counts what a training has done, and shows when it, or its stage, is over."""

import time

from drcli.base.log import get_logger
from drcli.model.alarms import trends
from drcli.model.checkpoints import Checkpoint, CheckpointStore
from drcli.model.history import History
from drcli.records.checkpoint import CheckpointName
from drcli.records.iteration import IterationRecord
from drcli.records.job import Job
from drcli.records.stage import PhaseMark, StageMark
from drcli.train.collect_rollouts import Collected
from drcli.train.goals import Goals
from drcli.train.stage_progress import Counted, StageProgress, phase_of


class TrainingProgress:
    def __init__(
        self,
        job: Job,
        found: Checkpoint | None,
        history: History,
        before_s: float,
        *,
        taught: bool = False,
    ) -> None:
        self._history = history
        self._before_s = before_s
        self._began_s = time.monotonic()
        self.newest, self.episodes = CheckpointName(0, 0), 0
        mark: StageMark | None = None
        phase: PhaseMark | None = None
        if found is not None:
            record = found.record
            self.newest = CheckpointName(record.number, record.steps)
            self.episodes, mark = record.counters.episodes, record.counters.stage
            phase = record.counters.phase
        self.phase = phase_of(phase, self.newest, taught=taught)
        self.stages = StageProgress(job.stages, mark, self.counted())
        self._world = job.config.race().world_name

    def begin_phase(self) -> None:
        self.phase = PhaseMark("teacher", self.newest.number, self.newest.steps)

    @property
    def first_iteration(self) -> int:
        first = 0 if self.phase is None else self.phase.iteration
        return max(first, self.stages.first_iteration)

    @property
    def first_step(self) -> int:
        return max(0 if self.phase is None else self.phase.steps, self.stages.first_step)

    @property
    def world(self) -> str:
        """Of the first worker, which evaluates."""
        return self._world if self.stages.mark is None else self.stages.mark.world

    @property
    def elapsed_s(self) -> float:
        return self._before_s + time.monotonic() - self._began_s

    def counted(self) -> Counted:
        return Counted(self.newest.number, self.newest.steps, self.episodes, self.elapsed_s)

    def record(self, collected: Collected) -> IterationRecord:
        return collected.record(
            self.newest,
            elapsed_s=self.elapsed_s,
            stage=self.stages.name,
            world=self.world,
            phase="" if self.phase is None else self.phase.name,
        )

    def advance(self, record: IterationRecord) -> None:
        self.newest = CheckpointName(record.iteration + 1, record.total_steps)
        self.episodes += record.episodes

    def reached(self, goals: Goals, *newest: IterationRecord) -> str | None:
        history, records = self._history, self._of_track(*newest)
        reached = goals.reached(
            records,
            history.count + len(newest),
            episodes=self.episodes,
            judged=self.stages.judged(records),
        )
        if reached is None and self.stages.is_last:
            over = self.stages.over(records, self.counted())
            if over is not None:
                return f"Training is complete: its last stage, {self.stages.name}, is over: {over}."
        return reached

    def _of_track(self, *newest: IterationRecord) -> list[IterationRecord]:
        records = (*self._history.records, *newest)
        return [record for record in records if record.world in ("", self.world)]

    def stage_over(self, record: IterationRecord) -> str | None:
        return self.stages.over(
            self._of_track(record),
            Counted(
                record.iteration + 1,
                record.total_steps,
                self.episodes + record.episodes,
                record.elapsed_s,
            ),
        )


# Warns when the learning curve shows that something goes wrong.


_logger = get_logger(__name__)


class LearningAlarms:
    def __init__(self, history: History, checkpoints: CheckpointStore) -> None:
        self._history = history
        self._checkpoints = checkpoints
        self._collapsed = False
        self._alarmed: set[str] = set()

    def check(self) -> str | None:
        """Returns a sentence if the model is collapsed."""
        fallen = self._history.collapse(self._checkpoints.best_name())
        for alarm in trends(self._history.records):
            if alarm.subject not in self._alarmed:
                _logger.warning("Warning: %s. %s", alarm.text, alarm.remedy)
            self._alarmed.add(alarm.subject)
        if fallen is not None and not self._collapsed:
            _logger.warning("%s.", fallen)
        self._collapsed = fallen is not None
        return fallen

    def begin_stage(self) -> None:
        self._collapsed = False

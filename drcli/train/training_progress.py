"""Counts what a training has done, and shows when it, its stage or its phase is over."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drcli.base.log import get_logger
from drcli.learn.phases import Phase
from drcli.model.alarms import trends
from drcli.model.checkpoints import Checkpoint, CheckpointStore
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.history import History
from drcli.records.checkpoint import CheckpointName
from drcli.records.iteration import IterationRecord
from drcli.records.job import Job
from drcli.records.stage import PhaseMark, RangesMark, Stage, StageMark
from drcli.train.goals import Goals, mean_score, target_of
from drcli.train.range_growth import NARROWEST
from drcli.train.rollouts import Collected

_logger = get_logger(__name__)

# Knows in which stage a training is, and when the next one begins.


def stage_index(stages: Sequence[Stage], mark: StageMark | None) -> int:
    if mark is None:
        return 0
    names = [stage.name for stage in stages]
    return names.index(mark.name) if mark.name in names else min(mark.number, len(names)) - 1


def parameters_of(stage: Stage | None, whole: Hyperparameters) -> Hyperparameters:
    if stage is None:
        return whole
    where = f"hyperparameters of stage {stage.name}"
    return Hyperparameters.from_bytes(stage.hyperparameters.encode(), where)


class StageProgress:
    """What is counted `now` comes as a `StageMark` without a name."""

    def __init__(self, stages: Sequence[Stage], mark: StageMark | None, now: StageMark) -> None:
        self._stages = stages
        self._at = stage_index(stages, mark)
        self.mark: StageMark | None = None
        if stages:
            self.mark = self._named(mark or now)

    @property
    def stage(self) -> Stage | None:
        return self._stages[self._at] if self._stages else None

    @property
    def name(self) -> str:
        return self.mark.name if self.mark is not None else ""

    @property
    def is_last(self) -> bool:
        return self._at >= len(self._stages) - 1

    @property
    def first_iteration(self) -> int:
        return self.mark.iteration if self.mark is not None else 0

    @property
    def first_step(self) -> int:
        """Schedules of hyperparameters begin again with it."""
        return self.mark.steps if self.mark is not None else 0

    def parameters(self, whole: Hyperparameters) -> Hyperparameters:
        return parameters_of(self.stage, whole)

    def judged(self, records: Sequence[IterationRecord]) -> Sequence[IterationRecord]:
        """Records by which the goals of the whole training judge."""
        if self.mark is None:
            return records
        return self._own(records) if self.is_last else ()

    def begin_next(self, now: StageMark) -> StageMark:
        self._at += 1
        self.mark = self._named(now)
        return self.mark

    def over(self, records: Sequence[IterationRecord], now: StageMark) -> str | None:
        """Why the stage is over; None if it is not. Older records may be missing."""
        stage, mark = self.stage, self.mark
        if stage is None or mark is None:
            return None
        goal = stage.goal
        own = self._own(records)
        for limit, done, words in (
            (goal.steps, now.steps - mark.steps, "steps"),
            (goal.episodes, now.episodes - mark.episodes, "episodes"),
            (goal.iterations, now.iteration - mark.iteration, "iterations"),
        ):
            if limit is not None and done >= limit:
                return "1 " + words[:-1] + " is done" if done == 1 else f"{done:,} {words} are done"
        if self.is_time_over(now.elapsed_s):
            one = goal.minutes == 1
            return "1 minute has passed" if one else f"{goal.minutes:g} minutes have passed"
        return self._good_enough(own)

    def is_time_over(self, elapsed_s: float) -> bool:
        return self.left_s(elapsed_s) <= 0.0

    def left_s(self, elapsed_s: float) -> float:
        if self.stage is None or self.mark is None or self.stage.goal.minutes is None:
            return math.inf
        return self.mark.elapsed_s + 60.0 * self.stage.goal.minutes - elapsed_s

    def _good_enough(self, own: Sequence[IterationRecord]) -> str | None:
        stage = self.stage
        assert stage is not None
        reached = []
        if stage.goal.evaluated:
            phrase = target_of(stage).reached(own)
            if phrase is None:
                return None
            reached.append(phrase)
        if stage.goal.mean_reward is not None:
            score = mean_score(own)
            if score is None or score < stage.goal.mean_reward:
                return None
            reached.append(f"the mean reward of 100 episodes is {score:.1f}")
        return " and ".join(reached) or None

    def _own(self, records: Sequence[IterationRecord]) -> Sequence[IterationRecord]:
        return [record for record in records if record.iteration >= self.first_iteration]

    def _named(self, mark: StageMark) -> StageMark:
        """The curriculum may have been changed meanwhile."""
        stage = self._stages[self._at]
        return replace(
            mark,
            name=stage.name,
            number=self._at + 1,
            count=len(self._stages),
            world=stage.race().world_name,
            goal=str(stage.goal),
        )


# Knows in which phase a training with a teacher is, and when the next one begins.


EPISODES: dict[Phase, int] = {"teacher": 32, "distillation": 24, "ppo": 20}
"""Least of an iteration: whole laps are driven by small steps of the policy, which need many."""

MIXED_ITERATIONS = 4
"""The teacher drives a falling share, so that the student sees good driving first, and then its
own.
"""

WINDOW: dict[Phase, int] = {"teacher": 10, "distillation": 5}
"""Compared with as many before."""

SURE_SHARE = 0.8
"""Of completed laps; below it nobody has learned to drive yet."""

SURE_ITERATIONS = 2
FOLLOWS = 0.03
"""A student follows its teacher if it earns less by at most this share."""

SATURATED = 0.04
"""Less improvement of a window ends a phase."""

MOST_STEPS: dict[Phase, int] = {"teacher": 500_000, "distillation": 80_000}
MANY_STEPS = 400_000
"""Of a student on several tracks, who has to see more, in a training without a limit of time."""

MANY_ITERATIONS = 15
"""As SURE_ITERATIONS, for a student on several tracks: each iteration drives other ones."""

TEACHER_SHARE = 0.25
"""Of the time, where a student needs more of it."""

MARGIN = 0.93
"""Of a lap time that somebody waits for: then a teacher is fast enough."""


def episodes_of(mark: PhaseMark | None, parameters: Hyperparameters) -> int:
    own = parameters.num_episodes_between_training
    return own if mark is None else max(own, EPISODES[mark.name])


def phase_of(
    known: PhaseMark | None, checkpoint: CheckpointName, *, taught: bool
) -> PhaseMark | None:
    """For trainer and workers alike; a training may have got or lost a teacher."""
    if not taught:
        return None
    return known or PhaseMark("teacher", checkpoint.number, checkpoint.steps)


def numbered_episodes(stages: Sequence[Stage], whole: Hyperparameters) -> int:
    """The most episodes of any stage or phase, as for `Share`; 0 if all are equal."""
    each = [parameters_of(stage, whole) for stage in stages] or [whole] * whole.taught
    return max(map(_most_episodes, each), default=0)


def _most_episodes(parameters: Hyperparameters) -> int:
    own = parameters.num_episodes_between_training
    return max(own, *EPISODES.values()) if parameters.taught else own


def teacher_drives(mark: PhaseMark, iteration: int, place: int) -> bool:
    if mark.name == "distillation":
        mixed = iteration - mark.iteration
        return place % MIXED_ITERATIONS >= mixed
    return mark.name == "teacher"


@dataclass(frozen=True)
class PhaseJudge:
    """Decides when a phase is over; `lap_time_s` is infinity for any lap.

    `many`: The training drives several tracks.
    """

    lap_time_s: float | None = None
    left_s: float = math.inf
    many: bool = False

    def most_steps(self, mark: PhaseMark) -> float:
        if self.many and mark.name == "distillation":
            return MANY_STEPS if math.isinf(self.left_s) else math.inf
        return MOST_STEPS[mark.name]

    def done(self, mark: PhaseMark, steps: int, records: Sequence[IterationRecord]) -> float:
        """Share of a phase that is over if nothing but its limits ends it, 0 .. 1."""
        spent_s = _spent_s(records, mark) if records else 0.0
        return max(steps / self.most_steps(mark), spent_s / max(spent_s + self.left_s, 1e-9))

    def next_mark(
        self, mark: PhaseMark, records: Sequence[IterationRecord]
    ) -> tuple[PhaseMark, str] | None:
        own = [record for record in records if record.iteration >= mark.iteration]
        if mark.name == "ppo" or not own:
            return None
        why = self._over(mark, own, [r for r in records if r.iteration < mark.iteration])
        if why is None:
            return None
        newest = own[-1]
        following: Phase = "distillation" if mark.name == "teacher" else "ppo"
        return PhaseMark(following, newest.iteration + 1, newest.total_steps), why

    def _over(
        self,
        mark: PhaseMark,
        own: Sequence[IterationRecord],
        before: Sequence[IterationRecord],
    ) -> str | None:
        steps = own[-1].total_steps - mark.steps
        if steps >= self.most_steps(mark):
            return f"it has taken {steps:,} steps"
        if mark.name == "teacher":
            if self._is_fast_enough(own[-1]):
                return f"its laps take {own[-1].best_lap_s:.2f} s"
            share = TEACHER_SHARE if self.many else 0.5
            spent_s = _spent_s([*before, *own], mark)
            if spent_s >= share * (spent_s + self.left_s):
                part = "a quarter" if self.many else "half"
                return f"{part} of the time is over"  # a student needs the rest
        if mark.name == "distillation":
            own = [r for r in own if r.iteration >= mark.iteration + MIXED_ITERATIONS]
            if self._follows(own, before):
                return "the student earns as much as its teacher"
            if self.many:
                return None  # it gains most in the end, while its learning rate falls
        window = WINDOW[mark.name]
        if len(own) < 2 * window:
            return None
        earlier, newest = own[-2 * window : -window], own[-window:]
        if _share(newest) < SURE_SHARE:
            return None
        gain = _mean_reward(newest) - _mean_reward(earlier)
        if gain > SATURATED * abs(_mean_reward(earlier)):
            return None
        return f"it has gained less than {SATURATED:.0%} in {window} iterations"

    def _follows(self, own: Sequence[IterationRecord], before: Sequence[IterationRecord]) -> bool:
        count = MANY_ITERATIONS if self.many else SURE_ITERATIONS
        if len(own) < count or not before or before[-1].phase != "teacher":
            return False
        wanted = _mean_reward(before[-count:])
        return _mean_reward(own[-count:]) >= wanted - FOLLOWS * abs(wanted)

    def _is_fast_enough(self, newest: IterationRecord) -> bool:
        if self.lap_time_s is None or newest.best_lap_s is None:
            return False
        is_sure = newest.full_laps >= SURE_SHARE * newest.episodes
        return is_sure and newest.best_lap_s <= MARGIN * self.lap_time_s


def _spent_s(records: Sequence[IterationRecord], mark: PhaseMark) -> float:
    before = [record.elapsed_s for record in records if record.iteration < mark.iteration]
    return records[-1].elapsed_s - (before[-1] if before else 0.0)


def _share(records: Sequence[IterationRecord]) -> float:
    return sum(r.full_laps for r in records) / max(1, sum(r.episodes for r in records))


def _mean_reward(records: Sequence[IterationRecord]) -> float:
    return sum(r.mean_reward for r in records) / len(records)


# All of a training.


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
        ranges: RangesMark | None = None
        if found is not None:
            record = found.record
            self.newest = CheckpointName(record.number, record.steps)
            self.episodes, mark = record.counters.episodes, record.counters.stage
            phase, ranges = record.counters.phase, record.counters.ranges
        self.phase = phase_of(phase, self.newest, taught=taught)
        self.stages = StageProgress(job.stages, mark, self.counted())
        self.ranges: RangesMark | None = None
        races = [*job.config.races, *(race for stage in job.stages for race in stage.races)]
        if any(race.sim_grow for race in races):
            self.ranges = ranges or RangesMark(NARROWEST, self.newest.number)
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

    def counted(self) -> StageMark:
        number, steps = self.newest.number, self.newest.steps
        return _counted(number, steps, self.episodes, self.elapsed_s)

    def record(self, collected: Collected) -> IterationRecord:
        return replace(
            collected.record,
            iteration=self.newest.number,
            total_steps=self.newest.steps + collected.rollout.steps,
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
            _counted(
                record.iteration + 1,
                record.total_steps,
                self.episodes + record.episodes,
                record.elapsed_s,
            ),
        )


def _counted(iteration: int, steps: int, episodes: int, elapsed_s: float) -> StageMark:
    return StageMark("", iteration=iteration, steps=steps, episodes=episodes, elapsed_s=elapsed_s)


# Warns when the learning curve shows that something goes wrong.


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

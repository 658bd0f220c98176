"""Knows in which stage a training is, and when the next one begins."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.stage import Stage, StageMark
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.workers.goals import mean_score, target_of


@dataclass(frozen=True)
class Counted:
    iteration: int
    steps: int
    episodes: int
    elapsed_s: float


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
    def __init__(self, stages: Sequence[Stage], mark: StageMark | None, now: Counted) -> None:
        self._stages = stages
        self._at = stage_index(stages, mark)
        self.mark: StageMark | None = None
        if stages:
            self.mark = self._marked(now) if mark is None else self._named(mark)

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

    def begin_next(self, now: Counted) -> StageMark:
        self._at += 1
        self.mark = self._marked(now)
        return self.mark

    def over(self, records: Sequence[IterationRecord], now: Counted) -> str | None:
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

    def _marked(self, now: Counted) -> StageMark:
        begun = StageMark(
            self._stages[self._at].name,
            iteration=now.iteration,
            steps=now.steps,
            episodes=now.episodes,
            elapsed_s=now.elapsed_s,
        )
        return self._named(begun)

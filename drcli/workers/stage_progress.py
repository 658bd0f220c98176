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
    """What a training has done until now, from its beginning.

    Attributes:
        iteration: Number of its newest checkpoint.
        steps: Steps driven.
        episodes: Training episodes driven.
        elapsed_s: Wall time of training.
    """

    iteration: int
    steps: int
    episodes: int
    elapsed_s: float


def stage_index(stages: Sequence[Stage], mark: StageMark | None) -> int:
    """The place of the marked stage, from 0; the first one where nothing is marked.

    A start makes sure that the stage still exists, so the number is only for safety.
    """
    if mark is None:
        return 0
    names = [stage.name for stage in stages]
    return names.index(mark.name) if mark.name in names else min(mark.number, len(names)) - 1


def parameters_of(stage: Stage | None, whole: Hyperparameters) -> Hyperparameters:
    """The hyperparameters of a stage; those of the whole training without one."""
    if stage is None:
        return whole
    where = f"hyperparameters of stage {stage.name}"
    return Hyperparameters.from_bytes(stage.hyperparameters.encode(), where)


class StageProgress:
    """The stage of a training.

    Args:
        stages: All of them; may be empty.
        mark: Of the newest checkpoint; None if it has none.
        now: What was counted until that checkpoint.
    """

    def __init__(self, stages: Sequence[Stage], mark: StageMark | None, now: Counted) -> None:
        self._stages = stages
        self._at = stage_index(stages, mark)
        self.mark: StageMark | None = None
        if stages:
            self.mark = self._marked(now) if mark is None else self._named(mark)

    @property
    def stage(self) -> Stage | None:
        """The present one; None without a curriculum."""
        return self._stages[self._at] if self._stages else None

    @property
    def name(self) -> str:
        """Name of the stage for records; empty without a curriculum."""
        return self.mark.name if self.mark is not None else ""

    @property
    def is_last(self) -> bool:
        """Whether no other stage follows."""
        return self._at >= len(self._stages) - 1

    @property
    def first_iteration(self) -> int:
        """Number of the first checkpoint of the stage; 0 without a curriculum."""
        return self.mark.iteration if self.mark is not None else 0

    @property
    def first_step(self) -> int:
        """Steps before the stage; schedules of hyperparameters begin again with it."""
        return self.mark.steps if self.mark is not None else 0

    def parameters(self, whole: Hyperparameters) -> Hyperparameters:
        """The hyperparameters of the stage, or those of the whole training."""
        return parameters_of(self.stage, whole)

    def judged(self, records: Sequence[IterationRecord]) -> Sequence[IterationRecord]:
        """The iterations by which the goals of the whole training judge how well the car drives."""
        if self.mark is None:
            return records
        return self._own(records) if self.is_last else ()

    def begin_next(self, now: Counted) -> StageMark:
        """Go on to the next stage; returns its mark."""
        self._at += 1
        self.mark = self._marked(now)
        return self.mark

    def over(self, records: Sequence[IterationRecord], now: Counted) -> str | None:
        """Why the stage is over, as a phrase; None if it is not.

        Args:
            records: Iterations until now; older ones may be missing.
            now: What was counted until now.
        """
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
        """Whether the minutes of the stage have passed, after so much wall time of training."""
        return self.left_s(elapsed_s) <= 0.0

    def left_s(self, elapsed_s: float) -> float:
        """Seconds that the minutes of the stage leave then; infinity without such a limit."""
        if self.stage is None or self.mark is None or self.stage.goal.minutes is None:
            return math.inf
        return self.mark.elapsed_s + 60.0 * self.stage.goal.minutes - elapsed_s

    def _good_enough(self, own: Sequence[IterationRecord]) -> str | None:
        """Which targets are reached, if all are."""
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
        """The mark with what the curriculum says now: it may have been changed meanwhile."""
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
        """The mark of the present stage, which begins now."""
        begun = StageMark(
            self._stages[self._at].name,
            iteration=now.iteration,
            steps=now.steps,
            episodes=now.episodes,
            elapsed_s=now.elapsed_s,
        )
        return self._named(begun)

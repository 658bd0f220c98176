"""Knows in which phase a training with a teacher is, and when the next one begins."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.phase import PhaseMark
from drcli.exchange.stage import Stage
from drcli.learn.phases import Phase
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.workers.stage_progress import parameters_of

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
"""It earns less by at most this share."""

SATURATED = 0.04
"""Less improvement of a window ends a phase."""

MOST_STEPS: dict[Phase, int] = {"teacher": 500_000, "distillation": 80_000}
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
    """Decides when a phase is over; `lap_time_s` is infinity for any lap."""

    lap_time_s: float | None = None
    left_s: float = math.inf

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
        if steps >= MOST_STEPS[mark.name]:
            return f"it has taken {steps:,} steps"
        if mark.name == "teacher":
            if self._is_fast_enough(own[-1]):
                return f"its laps take {own[-1].best_lap_s:.2f} s"
            if own[-1].elapsed_s - (before[-1].elapsed_s if before else 0.0) >= self.left_s:
                return "half of the time is over"  # a student needs the rest
        if mark.name == "distillation":
            own = [r for r in own if r.iteration >= mark.iteration + MIXED_ITERATIONS]
            if self._follows(own, before):
                return "the student earns as much as its teacher"
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

    @staticmethod
    def _follows(own: Sequence[IterationRecord], before: Sequence[IterationRecord]) -> bool:
        if len(own) < SURE_ITERATIONS or not before or before[-1].phase != "teacher":
            return False
        wanted = _mean_reward(before[-SURE_ITERATIONS:])
        return _mean_reward(own[-SURE_ITERATIONS:]) >= wanted - FOLLOWS * abs(wanted)

    def _is_fast_enough(self, newest: IterationRecord) -> bool:
        if self.lap_time_s is None or newest.best_lap_s is None:
            return False
        is_sure = newest.full_laps >= SURE_SHARE * newest.episodes
        return is_sure and newest.best_lap_s <= MARGIN * self.lap_time_s


def _share(records: Sequence[IterationRecord]) -> float:
    return sum(r.full_laps for r in records) / max(1, sum(r.episodes for r in records))


def _mean_reward(records: Sequence[IterationRecord]) -> float:
    return sum(r.mean_reward for r in records) / len(records)

"""Decides when a training is complete, and says so in advance when it starts."""

import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.job import Job
from drcli.modelfiles.hyperparameters import Hyperparameters

SCORED_EPISODES = 100
"""Episodes over which the mean reward of a stage is taken, as in the lists of the Gym."""


class Goals:
    """Knows when a training is complete.

    Args:
        job: With the limits of this start, or of the whole run.
        parameters: Of the model.
        clock: Monotonic seconds, for tests.
        before_s: How long earlier starts trained. It counts if the limit is that of the whole run.
        now: Unix seconds, for tests.
    """

    def __init__(
        self,
        job: Job,
        parameters: Hyperparameters,
        clock: Callable[[], float] = time.monotonic,
        *,
        before_s: float = 0.0,
        now: Callable[[], float] = time.time,
    ) -> None:
        self._job = job
        self._parameters = parameters
        self._clock = clock
        self._began_s = clock() - (before_s if job.whole_run else 0.0)
        # On the monotonic clock, so that nobody ends the training by setting the machine's clock.
        self._ends_s = None if job.ends_at is None else clock() + job.ends_at - now()

    def reached(
        self,
        records: Sequence[IterationRecord],
        count: int | None = None,
        *,
        episodes: int | None = None,
        judged: Sequence[IterationRecord] | None = None,
    ) -> str | None:
        """Why the training is complete, as one sentence; None if it is not.

        Args:
            records: The iterations so far, oldest first; older ones may be missing.
            count: How many iterations there are with the missing ones.
            episodes: How many training episodes there were with the missing ones.
            judged: The iterations that show how well the car drives, if not all: in a training
                with stages, those of the last stage.
        """
        episodes = sum(r.episodes for r in records) if episodes is None else episodes
        steps = records[-1].total_steps if records else 0
        count = len(records) if count is None else count
        return self._limit(count, episodes, steps) or self._target(
            records if judged is None else judged
        )

    def _limit(self, count: int, episodes: int, steps: int) -> str | None:
        """Why the training is complete, however well the car drives."""
        job, settings = self._job, self._job.config.train
        minutes = job.max_minutes
        if minutes is not None and self._clock() - self._began_s > 60.0 * minutes:
            return f"Training is complete: the time limit ({_minutes(minutes)}) was reached."
        if self._ends_s is not None and self._clock() >= self._ends_s:
            lived = _minutes(job.config.unattended.time_to_live_minutes)
            return f"Training is complete: {lived} have passed since its first start."
        most, name = _iteration_limit(job, self._parameters)
        if most <= count:
            done = "1 iteration is" if count == 1 else f"{count} iterations are"
            return f"Training is complete: {done} done, {name} is {most}."
        if 0 < settings.train_max_episodes <= episodes:
            done = "1 training episode is" if episodes == 1 else f"{episodes} training episodes are"
            return (
                f"Training is complete: {done} done, DR_TRAIN_MAX_EPISODES is "
                f"{settings.train_max_episodes}."
            )
        if 0 < settings.train_max_steps <= steps:
            return (
                f"Training is complete: {steps:,} steps are learned from, DR_TRAIN_MAX_STEPS is "
                f"{settings.train_max_steps:,}."
            )
        return None

    def _target(self, records: Sequence[IterationRecord]) -> str | None:
        """Why the training is complete because the car drives well enough."""
        job, settings = self._job, self._job.config.train
        evaluated = [record for record in records if record.evaluation_progress]
        most_s = job.until_lap_time_s
        if job.wanted_laps and evaluated and all_laps(evaluated[-1], job.wanted_laps, most_s):
            within = f", each in {most_s:g} s or less" if most_s is not None else ""
            return (
                f"Training is complete: all evaluation laps of a checkpoint were completed{within}."
            )
        slowest_s, lap_s = settings.train_stop_lap_time, mean_lap_s(evaluated[-1:])
        if lap_s is not None and lap_s <= slowest_s:
            return (
                "Training is complete: all evaluation laps of a checkpoint were completed, in "
                f"{lap_s:.2f} s on average; DR_TRAIN_STOP_LAP_TIME is {slowest_s:g}."
            )
        scored, good_enough = settings.train_stop_score_episodes, settings.train_stop_mean_score
        score = mean_score(records, scored)
        if score is not None and good_enough is not None and score >= good_enough:
            return (
                f"Training is complete: the mean reward of the last {_episodes(scored)} "
                f"is {score:.1f}, DR_TRAIN_STOP_MEAN_SCORE is {good_enough:g}."
            )
        wanted, last = settings.train_stop_progress, settings.train_stop_evaluations
        progress = [record.evaluation_progress for record in evaluated[-last:]]
        means = [sum(each) / len(each) for each in progress]
        if wanted > 0 and len(means) == last and min(means) >= wanted:
            return (
                f"Training is complete: the last {last} evaluations reached {min(means):.1f} % "
                f"and more, DR_TRAIN_STOP_PROGRESS is {wanted:g}."
            )
        return None


def mean_score(records: Sequence[IterationRecord], scored: int = SCORED_EPISODES) -> float | None:
    """Mean reward of the last training episodes; None if there are fewer than `scored`."""
    episodes, total = 0, 0.0
    for record in reversed(records):
        counted = min(record.episodes, scored - episodes)
        episodes += counted
        total += counted * record.mean_reward
        if episodes == scored:
            return total / episodes
    return None


def mean_lap_s(evaluated: Sequence[IterationRecord]) -> float | None:
    """Mean lap time of these evaluations, simulated seconds; None unless each lap was completed."""
    laps = [lap_s for record in evaluated for lap_s in record.evaluation_lap_s]
    if not laps or len(laps) != sum(len(record.evaluation_progress) for record in evaluated):
        return None
    return sum(laps) / len(laps)


def all_laps(record: IterationRecord, wanted: int, most_s: float | None = None) -> bool:
    """Whether all laps of an evaluation were completed, at least so many, each within `most_s`."""
    laps = record.evaluation_lap_s
    complete = len(laps) >= wanted and len(laps) == len(record.evaluation_progress)
    return complete and (most_s is None or max(laps, default=0.0) <= most_s)


def ending(job: Job, parameters: Hyperparameters) -> str:
    """A sentence with everything that ends the training."""
    settings = job.config.train
    ways = []
    judged = " in the last stage" if len(job.stages) > 1 else ""
    if job.stages and not job.stages[-1].goal.empty:
        last = job.stages[-1]
        ways.append(f"with the last of {_stages(job)}, {last.name}: {last.goal}")
    if job.until_lap_time_s is not None:
        ways.append(
            f"once each evaluation lap of a checkpoint{judged}, at least {job.wanted_laps}, takes "
            f"{job.until_lap_time_s:g} s or less (--until-lap-time)"
        )
    elif job.until_laps is not None:
        ways.append(
            f"once a checkpoint completes all its evaluation laps{judged}, "
            f"at least {job.until_laps} (--until-laps)"
        )
    if job.max_minutes is not None:
        given = job.max_minutes == settings.train_max_minutes
        ways.append(
            f"after {_minutes(job.max_minutes)} {'of all starts together ' * job.whole_run}"
            f"({'DR_TRAIN_MAX_MINUTES' if given else '--max-minutes'})"
        )
    if job.ends_at is not None:
        at = datetime.fromtimestamp(job.ends_at, UTC)
        ways.append(f"at {at:%Y-%m-%d %H:%M} UTC (DR_TIME_TO_LIVE_MINUTES)")
    most, name = _iteration_limit(job, parameters)
    ways.append(f"after {'1 iteration' if most == 1 else f'{most:,} iterations'} ({name})")
    if settings.train_max_episodes > 0:
        ways.append(
            f"after {_episodes(settings.train_max_episodes, 'training ')} (DR_TRAIN_MAX_EPISODES)"
        )
    if settings.train_max_steps > 0:
        ways.append(f"after {settings.train_max_steps:,} steps (DR_TRAIN_MAX_STEPS)")
    if settings.train_stop_lap_time > 0.0:
        ways.append(
            f"once all evaluation laps of a checkpoint take {settings.train_stop_lap_time:g} s or "
            f"less on average{judged} (DR_TRAIN_STOP_LAP_TIME)"
        )
    if settings.train_stop_mean_score is not None:
        ways.append(
            f"at a mean reward of {settings.train_stop_mean_score:g} over "
            f"{_episodes(settings.train_stop_score_episodes)}{judged} (DR_TRAIN_STOP_MEAN_SCORE)"
        )
    if settings.train_stop_progress > 0:
        ways.append(
            f"at {settings.train_stop_progress:g} % of mean progress in "
            f"{settings.train_stop_evaluations} evaluations in a row{judged} "
            "(DR_TRAIN_STOP_PROGRESS)"
        )
    return f"Ends {', or '.join([*ways, 'with dr-stop-training'])}."


def _stages(job: Job) -> str:
    return "1 stage" if len(job.stages) == 1 else f"{len(job.stages)} stages"


def _episodes(count: int, kind: str = "") -> str:
    return f"1 {kind}episode" if count == 1 else f"{count:,} {kind}episodes"


def _iteration_limit(job: Job, parameters: Hyperparameters) -> tuple[int, str]:
    """The smaller of the two limits, which counts first, and its name."""
    limits = [(parameters.term_cond_max_episodes, "term_cond_max_episodes")]
    if job.config.train.train_max_iterations > 0:
        limits.append((job.config.train.train_max_iterations, "DR_TRAIN_MAX_ITERATIONS"))
    return min(limits)


def _minutes(count: float) -> str:
    return "1 minute" if count == 1 else f"{count:g} minutes"

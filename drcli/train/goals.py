"""Decides when a training is complete, and says so in advance when it starts."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import fmean

from drcli.model.files.hyperparameters import Hyperparameters
from drcli.records.iteration import CONFIRMING_CLEAN, CONFIRMING_LAPS, IterationRecord, Laps
from drcli.records.job import Job
from drcli.records.stage import Stage

FAST_LAPS = 5
"""So many at least for a lap time."""

SCORED_EPISODES = 100
"""For the mean reward of a stage, as in the lists of the Gym."""

CONFIRMED = f", and then {CONFIRMING_CLEAN} of {CONFIRMING_LAPS} laps from other starts are as good"
CONFIRMED_PROGRESS = f", and on {CONFIRMING_LAPS} laps from other starts"


@dataclass(frozen=True)
class Target:
    """What the evaluations of checkpoints must show to end a training or a stage.

    Of many evaluations, one passes by luck some day. So the checkpoint then drives again from
    other starts, and these laps decide.

    Attributes:
        laps: All are clean, so many at least; None if they need not be completed.
        most_s: Of each lap, simulated seconds.
        mean_s: The same on average.
        progress: Least mean, percent.
        evaluations: How many in a row must show it.
    """

    name: str
    laps: int | None = None
    most_s: float | None = None
    mean_s: float | None = None
    progress: float | None = None
    evaluations: int = 1

    @property
    def lap_time_s(self) -> float:
        return min((s for s in (self.most_s, self.mean_s) if s is not None), default=math.inf)

    def shown_by(self, progress: Sequence[float], lap_s: Sequence[float]) -> bool:
        """By percent of all, seconds of clean laps."""
        clean = self.laps is None or len(lap_s) >= max(self.laps, len(progress))
        within = self.most_s is None or max(lap_s, default=0.0) <= self.most_s
        return clean and within and self._averages_hold(progress, lap_s)

    def confirmed_by(self, progress: Sequence[float], lap_s: Sequence[float]) -> bool:
        """By the `CONFIRMING_LAPS` that it drove again."""
        fast = Laps(len(progress), lap_s).within(self.most_s).clean
        clean = self.laps is None or fast >= CONFIRMING_CLEAN
        return bool(progress) and clean and self._averages_hold(progress, lap_s)

    def _reached_by(self, records: Sequence[IterationRecord]) -> IterationRecord | None:
        """If one evaluation is enough, any will do: a worse one may have arrived after it."""
        if self.evaluations == 1:
            runs = [[r] for r in reversed(records) if r.confirmation_progress]
        else:
            runs = [[r for r in records if r.evaluation_progress][-self.evaluations :]]
        for run in runs:
            shown = (self.shown_by(r.evaluation_progress, r.evaluation_lap_s) for r in run)
            if len(run) == self.evaluations and all(shown):
                last = run[-1]
                if self.confirmed_by(last.confirmation_progress, last.confirmation_lap_s):
                    return last
        return None

    def _averages_hold(self, progress: Sequence[float], lap_s: Sequence[float]) -> bool:
        if self.mean_s is not None and (not lap_s or fmean(lap_s) > self.mean_s):
            return False
        return self.progress is None or fmean(progress) >= self.progress

    def reached(self, records: Sequence[IterationRecord]) -> str | None:
        """Which checkpoint has reached it, as a phrase."""
        last = self._reached_by(records)
        if last is None:
            return None
        laps = Laps(len(last.confirmation_progress), last.confirmation_lap_s)
        words = f"checkpoint {last.iteration} drove {laps}"
        within = laps.within(self.most_s).clean
        if within < laps.clean:
            words += f", {within} of them in {self.most_s:g} s or less"
        if self.mean_s is not None:
            words += f", {fmean(laps.clean_s):.2f} s on average"
        if self.laps is None:
            words += f", {fmean(last.confirmation_progress):.1f} % of the lap on average"
        return f"{words}, from starts that it had not driven before ({self.name})"


def target_of(stage: Stage) -> Target:
    goal = stage.goal
    laps = goal.laps if goal.lap_time is None else goal.laps or 1
    name = f"goal of stage {stage.name}"
    return Target(name, laps, None, goal.lap_time, goal.progress, goal.evaluations)


@dataclass(frozen=True)
class Option:
    """How a start asks for a goal, on the command line and in the form of the page.

    Attributes:
        key: In `Job.goals` and in the body of the page.
        help: Of the command line.
        label: In the form, with a `hint` below it.
    """

    key: str
    metavar: str
    help: str
    label: str
    hint: str
    low: float
    high: float | None = None
    whole: bool = False


@dataclass(frozen=True)
class Goal:
    """Something that a start or a setting asks for, and that ends the training.

    Attributes:
        name: Of the option or the setting.
        value: What a job asks for; None if it does not.
        words: When that ends a training, for `ending`.
        limit: By training episodes and steps so far: why it is over, however well the car drives.
        target: What evaluations must show.
        score: Why the newest training episodes end it.
    """

    name: str
    value: Callable[[Job], float | None]
    words: Callable[[Job, float], str]
    limit: Callable[[float, int, int], str | None] | None = None
    target: Callable[[str, Job, float], Target] | None = None
    score: Callable[[Job, float, Sequence[IterationRecord]], str | None] | None = None
    option: Option | None = None

    def way(self, job: Job) -> list[str]:
        value = self.value(job)
        return [] if value is None else [f"{self.words(job, value)} ({self.name})"]


def _set(field: str) -> Callable[[Job], float | None]:
    return lambda job: getattr(job.config.train, field) or None


def _episode_limit(most: float, episodes: int, steps: int) -> str | None:
    done = "1 training episode is" if episodes == 1 else f"{episodes} training episodes are"
    words = f"{done} done, DR_TRAIN_MAX_EPISODES is {most}"
    return words if episodes >= most else None


def _step_limit(most: float, episodes: int, steps: int) -> str | None:
    words = f"{steps:,} steps are learned from, DR_TRAIN_MAX_STEPS is {most:,}"
    return words if steps >= most else None


def _score_reached(job: Job, least: float, records: Sequence[IterationRecord]) -> str | None:
    scored = job.config.train.train_stop_score_episodes
    score = mean_score(records, scored)
    if score is None or score < least:
        return None
    return (
        f"the mean reward of the last {_episodes(scored)} is {score:.1f}, DR_TRAIN_STOP_MEAN_SCORE "
        f"is {least:g}"
    )


def _wanted_laps(job: Job) -> int:
    return int(job.goals.get("until_laps") or FAST_LAPS)


def _judged(job: Job) -> str:
    return " in the last stage" if len(job.stages) > 1 else ""


GOALS = (
    Goal(
        "--until-lap-time",
        lambda job: job.goals.get("until_lap_time_s"),
        lambda job, most_s: (
            f"once each evaluation lap of a checkpoint{_judged(job)}, at least "
            f"{_wanted_laps(job)}, takes {most_s:g} s or less{CONFIRMED}"
        ),
        target=lambda name, job, most_s: Target(name, _wanted_laps(job), most_s),
        option=Option(
            "until_lap_time_s",
            "S",
            "Stop when each of these laps takes S seconds or less.",
            "Stop at a lap time, s (this start only)",
            "Ends when each of these laps takes this many seconds or less.",
            low=0.1,
            high=10_000.0,
        ),
    ),
    Goal(
        "--until-laps",
        # A lap time asks for that many itself.
        lambda job: None if "until_lap_time_s" in job.goals else job.goals.get("until_laps"),
        lambda job, laps: (
            f"once a checkpoint completes all its evaluation laps{_judged(job)}, at least "
            f"{int(laps)}{CONFIRMED}"
        ),
        target=lambda name, job, laps: Target(name, int(laps)),
        option=Option(
            "until_laps",
            "N",
            "Stop when all evaluation laps of a checkpoint are clean, N or more, and then 38 of 40 "
            "from other starts.",
            "Stop after laps (this start only)",
            "Ends when all evaluation laps of a checkpoint are clean, this many or more, and then "
            "38 of 40 from other starts.",
            low=1,
            whole=True,
        ),
    ),
    Goal(
        "DR_TRAIN_MAX_EPISODES",
        _set("train_max_episodes"),
        lambda job, most: f"after {_episodes(int(most), 'training ')}",
        limit=_episode_limit,
    ),
    Goal(
        "DR_TRAIN_MAX_STEPS",
        _set("train_max_steps"),
        lambda job, most: f"after {most:,} steps",
        limit=_step_limit,
    ),
    Goal(
        "DR_TRAIN_STOP_LAP_TIME",
        _set("train_stop_lap_time"),
        lambda job, mean_s: (
            f"once all evaluation laps of a checkpoint take {mean_s:g} s or less on "
            f"average{_judged(job)}{CONFIRMED}"
        ),
        target=lambda name, job, mean_s: Target(name, 1, mean_s=mean_s),
    ),
    Goal(
        "DR_TRAIN_STOP_MEAN_SCORE",
        lambda job: job.config.train.train_stop_mean_score,
        lambda job, least: (
            f"at a mean reward of {least:g} over "
            f"{_episodes(job.config.train.train_stop_score_episodes)}{_judged(job)}"
        ),
        score=_score_reached,
    ),
    Goal(
        "DR_TRAIN_STOP_PROGRESS",
        _set("train_stop_progress"),
        lambda job, least: (
            f"at {least:g} % of mean progress in {job.config.train.train_stop_evaluations} "
            f"evaluations in a row{_judged(job)}{CONFIRMED_PROGRESS}"
        ),
        target=lambda name, job, least: Target(
            name, progress=least, evaluations=job.config.train.train_stop_evaluations
        ),
    ),
)
"""In the order of the sentence; what a start asks for comes first."""

OPTIONS = {goal.option.key: goal.option for goal in GOALS if goal.option is not None}


def targets_of(job: Job, stage: Stage | None = None) -> list[Target]:
    """Those of the whole training count in its last stage only."""
    targets = []
    if stage is not None and stage.goal.evaluated:
        targets.append(target_of(stage))
    if stage is not None and stage != job.stages[-1]:
        return targets
    for goal in GOALS:
        if goal.target is not None and (value := goal.value(job)) is not None:
            name = f"{goal.name}{'=' if goal.option is None else ' '}{value:g}"
            targets.append(goal.target(name, job, value))
    return targets


class Goals:
    """Knows when a training is complete.

    `before_s`, the time of earlier starts, counts only for a whole run.
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
        # On the monotonic clock, so that nobody ends the training by setting the machine's clock.
        now_s = clock()
        # A trainer that died and starts again begins no new start.
        began_s = now_s - before_s if job.whole_run else job.began_s or now_s
        self._ends_s: list[tuple[float, str]] = []
        if (minutes := job.max_minutes) is not None:
            why = f"the time limit ({_minutes(minutes)}) was reached."
            self._ends_s.append((began_s + 60.0 * minutes, why))
        if job.ends_at is not None:
            lived = _minutes(job.config.unattended.time_to_live_minutes)
            why = f"{lived} have passed since its first start."
            self._ends_s.append((clock() + job.ends_at - now(), why))

    def late_s(self) -> float:
        """Negative before a time limit, -inf without one."""
        return self._clock() - min((at_s for at_s, _ in self._ends_s), default=float("inf"))

    def reached(
        self,
        records: Sequence[IterationRecord],
        count: int | None = None,
        *,
        episodes: int | None = None,
        judged: Sequence[IterationRecord] | None = None,
    ) -> str | None:
        """Why the training is complete; None if it is not.

        `count` and `episodes` include records that are missing. `judged` are those of the last
        stage.
        """
        episodes = sum(r.episodes for r in records) if episodes is None else episodes
        steps = records[-1].total_steps if records else 0
        count = len(records) if count is None else count
        return self._limit(count, episodes, steps) or self._target(
            records if judged is None else judged
        )

    def _limit(self, count: int, episodes: int, steps: int) -> str | None:
        """However well the car drives."""
        job = self._job
        for at_s, why in self._ends_s:
            if self._clock() >= at_s:
                return f"Training is complete: {why}"
        most, name = _iteration_limit(job, self._parameters)
        if most <= count:
            done = "1 iteration is" if count == 1 else f"{count} iterations are"
            return f"Training is complete: {done} done, {name} is {most}."
        for goal in GOALS:
            if goal.limit is not None and (value := goal.value(job)) is not None:
                over = goal.limit(value, episodes, steps)
                if over is not None:
                    return f"Training is complete: {over}."
        return None

    def _target(self, records: Sequence[IterationRecord]) -> str | None:
        job = self._job
        phrases = [target.reached(records) for target in targets_of(job)]
        phrases += [
            goal.score(job, value, records)
            for goal in GOALS
            if goal.score is not None and (value := goal.value(job)) is not None
        ]
        phrase = next((phrase for phrase in phrases if phrase is not None), None)
        return None if phrase is None else f"Training is complete: {phrase}."


def mean_score(records: Sequence[IterationRecord], scored: int = SCORED_EPISODES) -> float | None:
    """None for fewer than `scored`; episodes of a teacher do not count."""
    episodes, total = 0, 0.0
    for record in reversed([record for record in records if record.is_own_driving]):
        counted = min(record.episodes, scored - episodes)
        episodes += counted
        total += counted * record.mean_reward
        if episodes == scored:
            return total / episodes
    return None


def ending(job: Job, parameters: Hyperparameters) -> str:
    settings = job.config.train
    ways = []
    if job.stages and not job.stages[-1].goal.empty:
        last = job.stages[-1]
        ways.append(f"with the last of {_stages(job)}, {last.name}: {last.goal}")
    ways += [way for goal in GOALS if goal.option is not None for way in goal.way(job)]
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
    ways.append(
        f"after {'1 iteration' if most == 1 else f'{most:,} iterations'} ({name}{_meaning(name)})"
    )
    ways += [way for goal in GOALS if goal.option is None for way in goal.way(job)]
    return f"Ends {', or '.join([*ways, 'with dr-stop-training'])}."


def same_goals(one: str, other: str) -> bool:
    """In version 0.1.0, no target was confirmed; trainings complete then stay so."""
    for words in (CONFIRMED, CONFIRMED_PROGRESS):
        one, other = one.replace(words, ""), other.replace(words, "")
    return one == other


def _stages(job: Job) -> str:
    return "1 stage" if len(job.stages) == 1 else f"{len(job.stages)} stages"


def _episodes(count: int, kind: str = "") -> str:
    return f"1 {kind}episode" if count == 1 else f"{count:,} {kind}episodes"


def _iteration_limit(job: Job, parameters: Hyperparameters) -> tuple[int, str]:
    limits = [(parameters.term_cond_max_episodes, "term_cond_max_episodes")]
    if job.config.train.train_max_iterations > 0:
        limits.append((job.config.train.train_max_iterations, "DR_TRAIN_MAX_ITERATIONS"))
    return min(limits)


def _meaning(limit: str) -> str:
    return "; it counts iterations" if limit == "term_cond_max_episodes" else ""


def _minutes(count: float) -> str:
    return "1 minute" if count == 1 else f"{count:g} minutes"

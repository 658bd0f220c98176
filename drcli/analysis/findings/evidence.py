"""All that verdict and advice rest on, computed once."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drcli.analysis.findings.action_use import ActionUse, action_use
from drcli.analysis.findings.driven_steps import (
    DiscountHorizon,
    DrivenSteps,
    EpisodeEnds,
    EpisodeGroup,
    by_quintile,
    by_start,
    discount_horizon,
    driven_steps,
    episode_ends,
)
from drcli.analysis.findings.evaluated_laps import (
    EvaluatedLaps,
    evaluated_alone,
    evaluated_in_training,
)
from drcli.analysis.findings.learning_curve import (
    LEAST_NOISE,
    TREND_T,
    Fall,
    LearningCurve,
    lasting_fall,
    learning_curve,
    rolling,
)
from drcli.analysis.findings.reward_rate import (
    RewardRate,
    change_t,
    lap_slowing,
    reward_rate,
)
from drcli.analysis.findings.steering import (
    Snaking,
    SteeringBalance,
    WheelsOff,
    snaking,
    steering_balance,
    wheels_off,
)
from drcli.analysis.run import Run
from drcli.base.json_record import RecordError, decode_json
from drcli.learn.algorithms import ALGORITHMS, Algorithm, algorithm_named
from drcli.model.alarms import ENTROPY_NEAR, ENTROPY_RISE, ENTROPY_SINCE, ENTROPY_WINDOW
from drcli.model.files.action_space import ActionSpace
from drcli.model.keys import MODEL_METADATA_FILE
from drsim.arrays import Floats

if TYPE_CHECKING:
    import pandas as pd

# Which steps show how the car drives now.


LATE_SHARE = 3
LEAST_STEPS = 1500


def split_steps(
    steps: DrivenSteps, curve: LearningCurve, fall: Fall | None
) -> tuple[DrivenSteps, DrivenSteps, DrivenSteps]:
    """All steps on the present track before a collapse; the last and the first third of them."""
    if not len(curve):
        return steps, steps, steps.where(np.zeros(len(steps), dtype=bool))
    numbers, learned = curve.iteration, steps.iteration >= curve.iteration[0]
    if fall is not None:
        learned &= steps.iteration < numbers[fall.at]
        numbers = numbers[: fall.at]
    counts = np.bincount(np.maximum(steps.iteration, 0), minlength=int(numbers[-1]) + 1)
    enough = int(np.searchsorted(np.cumsum(counts[numbers[::-1]]), LEAST_STEPS)) + 1
    third = -(-len(numbers) // LATE_SHARE)
    late = numbers[-min(len(numbers), max(third, enough)) :]
    parts = [
        steps.where((steps.iteration >= part[0]) & (steps.iteration <= part[-1]))
        for part in (late, numbers[:third])
    ]
    return steps.where(learned), parts[0], parts[1]


# Complete laps: number, times, records.


PERCENTILES = (1, 10, 25, 50, 75)
"""As in the tables of deepracer-on-the-spot."""


@dataclass(frozen=True)
class BestLap:
    iteration: int
    unique_episode: int
    seconds: float


@dataclass(frozen=True)
class LapTimes:
    """The complete laps; `median_s` is of the last third."""

    laps: int
    first_iteration: int | None
    best_s: float | None
    median_s: float | None
    percentiles: dict[int, float]
    best_laps: tuple[BestLap, ...]


def lap_times(run: Run) -> LapTimes:
    table = run.episodes
    done = table[table["complete"].astype(bool) & (table["time"] > 0)]
    if not len(done):
        return LapTimes(0, None, None, None, {}, ())
    done = done.sort_values("iteration", kind="stable")
    time_s, iteration = done["time"].to_numpy(np.float64), done["iteration"].to_numpy(np.int64)
    best = done[done["time"] < done["time"].cummin().shift(fill_value=math.inf)]
    first, last = int(table["iteration"].min()), int(table["iteration"].max())
    late = time_s[iteration > last - (last - first + 1) / 3]
    return LapTimes(
        laps=len(done),
        first_iteration=int(iteration.min()),
        best_s=float(time_s.min()),
        median_s=float(np.median(late)) if len(late) else None,
        percentiles={p: float(np.percentile(time_s, p)) for p in PERCENTILES},
        best_laps=tuple(
            BestLap(int(row["iteration"]), int(name), float(row["time"]))
            for name, row in best.iterrows()
        ),
    )


# What entropy, KL divergence and losses say about the updates.


@dataclass(frozen=True)
class LearnerHealth:
    """The updates of a training; None where nothing was recorded.

    Attributes:
        lowest_entropy: Nats; mean over five updates.
        spread: `last_entropy` as a share of that of equal probabilities.
        rising_since: Updates since it was lowest, if it rises as `dr-status` warns of.
        clip_fraction: Share of the steps whose probability ratio was clipped.
    """

    updates: int
    first_entropy: float | None
    last_entropy: float | None
    lowest_entropy: float | None
    spread: float | None
    rising_since: int | None
    median_kl: float | None
    last_value_loss: float | None
    clip_fraction: float | None


def learner_health(
    learner: "pd.DataFrame", algorithm: Algorithm, actions: int = 0
) -> LearnerHealth | None:
    """Judge the updates in `Run.learner`."""
    if not len(learner):
        return None
    entropy, kl = _known(learner, "entropy"), _known(learner, "kl")
    means = rolling(entropy, ENTROPY_WINDOW)[ENTROPY_WINDOW - 1 :]
    last = _mean(entropy[-ENTROPY_WINDOW:])
    return LearnerHealth(
        updates=len(learner),
        first_entropy=_mean(entropy[:ENTROPY_WINDOW]),
        last_entropy=last,
        lowest_entropy=float(means.min()) if len(means) else None,
        spread=None if last is None or actions < 2 else last / math.log(actions),
        rising_since=None if algorithm.steers_entropy else _rising_since(means),
        median_kl=float(np.median(kl)) if len(kl) else None,
        last_value_loss=_mean(_known(learner, "value_loss")[-ENTROPY_WINDOW:]),
        clip_fraction=_mean(_known(learner, "clip_fraction")[-ENTROPY_WINDOW:]),
    )


def _rising_since(means: Floats) -> int | None:
    if len(means) <= ENTROPY_SINCE:
        return None
    low = int(np.flatnonzero(means <= means.min() + ENTROPY_NEAR)[-1])
    since = len(means) - 1 - low
    risen = since >= ENTROPY_SINCE and means[-1] >= means.min() + ENTROPY_RISE
    return since if risen else None


def _known(learner: "pd.DataFrame", name: str) -> Floats:
    if name not in learner:
        return np.empty(0)
    values = np.asarray(learner[name], dtype=np.float64)
    return values[np.isfinite(values)]


def _mean(values: Floats) -> float | None:
    return float(values.mean()) if len(values) else None


# Progress of evaluations and of training episodes.


NEWEST = 8
LEAST = 3


@dataclass(frozen=True)
class EvaluationGap:
    """Mean progress of training and evaluation, percent.

    Attributes:
        t: `behind` in standard errors.
        count: Evaluated iterations, or trials if `alone`.
        alone: Evaluations on their own, after the training.
    """

    training: float
    evaluation: float
    behind: float
    t: float
    count: int
    alone: bool


def evaluation_gap(run: Run, curve: LearningCurve, until: int) -> EvaluationGap | None:
    """Compare evaluations with the first `until` iterations."""
    training, evaluation = curve.progress[:until], curve.evaluation[:until]
    where = np.flatnonzero(np.isfinite(evaluation))
    where = where[-max(NEWEST, len(where) // 3) :]
    where = where[where >= until - max(2 * NEWEST, until // 2)]
    if len(where) >= LEAST:
        gaps = training[where] - evaluation[where]
        return _gap(training[where], evaluation[where], float(np.std(gaps, ddof=1)), alone=False)
    trials = [
        float(progress)
        for each in run.evaluations[-3:]
        if each.world is None or run.world is None or each.world == run.world
        for progress in each.trials["alone_progress"]  # an episode ends at the first violation
        if math.isfinite(progress)
    ]
    newest = training[-NEWEST:]
    if len(trials) < LEAST or len(newest) < LEAST:
        return None
    tried = np.array(trials)
    return _gap(np.full(len(tried), newest.mean()), tried, float(np.std(tried, ddof=1)), alone=True)


def _gap(
    training: np.ndarray, evaluation: np.ndarray, spread: float, *, alone: bool
) -> EvaluationGap:
    first, second = float(np.mean(training)), float(np.mean(evaluation))
    error = max(spread, 2.0) / math.sqrt(len(evaluation))
    return EvaluationGap(
        first, second, first - second, (first - second) / error, len(evaluation), alone
    )


FALL_FROM = 20.0
"""Percent. The warning during a training asks for 40; a whole curve shows smaller falls."""

REWARD_FALL = 0.4
"""Stricter than for the progress."""

REWARD_RISE = 1.1
"""A fall of progress with so much more reward was paid for."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was found in a training. None stands for: too few numbers to tell.

    Attributes:
        fallen: What fell: progress or reward; empty without a collapse.
        paid: Whether the reward rose where the progress fell. Then the policy is not broken; it
            does what its reward asks for.
        late: Steps that show how the car drives now, or before the policy broke.
    """

    run: Run
    curve: LearningCurve
    fall: Fall | None
    fallen: str
    paid: bool
    late: DrivenSteps
    actions: ActionUse | None
    rate: RewardRate | None
    balance: SteeringBalance | None
    snaking: Snaking | None
    evaluation_snaking: Snaking | None
    off: WheelsOff | None
    ends: EpisodeEnds | None
    evaluated: EvaluatedLaps | None
    evaluated_in_training: EvaluatedLaps | None
    gap: EvaluationGap | None
    learner: LearnerHealth | None
    horizon: DiscountHorizon | None
    laps: LapTimes
    quintiles: tuple[EpisodeGroup, ...]
    starts: tuple[EpisodeGroup, ...]

    @property
    def until(self) -> int:
        """Number of iterations before the policy broke, or all."""
        return len(self.curve) if self.fall is None or self.paid else self.fall.at

    @property
    def level(self) -> float:
        """Mean progress of the newest iterations before a collapse, percent."""
        newest = self.curve.progress[: self.until][-max(3, self.until // 6) :]
        return float(newest.mean()) if len(newest) else 0.0

    @property
    def spread(self) -> float | None:
        """How evenly the probabilities of discrete actions are spread: 0 one is certain, 1 equal.

        From the entropy of the newest updates, else from the actions at the same place of the lap,
        which vary at least as much.
        """
        if self.learner is not None and self.learner.spread is not None:
            return self.learner.spread
        use = self.actions
        return None if use is None or use.continuous else use.variety

    def number(self, key: str) -> float | None:
        return _number(self.run.hyperparameters, key)


def gather(run: Run) -> Evidence:
    curve = learning_curve(run)
    fall, fallen = _fall(curve) if curve.is_own_driving else (None, "")
    paid = _paid(curve, fall, fallen)
    broken = None if paid else fall
    until = len(curve) if broken is None else broken.at
    steps = driven_steps(run.steps)
    learned, late, early = split_steps(steps, curve, broken)
    evaluated = [driven_steps(each.steps) for each in run.evaluations[-3:]]
    restless = [found for each in evaluated if (found := snaking(each)) is not None]
    return Evidence(
        run=run,
        curve=curve,
        fall=fall,
        fallen=fallen,
        paid=paid,
        late=late,
        actions=action_use(late, early, run.actions),
        rate=reward_rate(learned, late, run.episodes, run.actions, lap_slowing(run, curve, until)),
        balance=steering_balance(late, run.track),
        snaking=snaking(late),
        evaluation_snaking=restless[-1] if restless else None,
        off=wheels_off(late),
        ends=episode_ends(late),
        evaluated=evaluated_alone(run),
        evaluated_in_training=evaluated_in_training(run, curve),
        gap=evaluation_gap(run, curve, until),
        learner=learner_health(
            _since_phase(run.learner, curve), algorithm_of(run), actions=_discrete(run.actions)
        ),
        horizon=discount_horizon(run.hyperparameters, steps.length_m, _speed_over_track(late)),
        laps=lap_times(run),
        quintiles=by_quintile(run),
        starts=by_start(run),
    )


def _since_phase(learner: "pd.DataFrame", curve: LearningCurve) -> "pd.DataFrame":
    """The updates of the newest phase: those before are of another network."""
    if not curve.phase or not len(curve):
        return learner
    return learner[learner.index >= curve.iteration[0]]


def algorithm_of(run: Run) -> Algorithm:
    """Which algorithm trained a model.

    sac_alpha does not tell: the reference ships it with hyperparameters of PPO.
    """
    with suppress(RecordError):
        text = run.files.get(MODEL_METADATA_FILE, "{}")
        metadata = decode_json(dict[str, Any], text.encode())
        if "training_algorithm" in metadata:
            return algorithm_named(metadata["training_algorithm"])
    explores = run.hyperparameters.get("exploration_type")
    known = (each for each in ALGORITHMS.values() if each.explores == explores)
    return next(known, algorithm_named(None))


def _discrete(actions: ActionSpace | None) -> int:
    return 0 if actions is None or actions.continuous else actions.num_actions


def _fall(curve: LearningCurve) -> tuple[Fall | None, str]:
    fall = lasting_fall(curve.progress, FALL_FROM, least_noise=LEAST_NOISE)
    if fall is not None:
        return fall, "progress"
    if len(curve) and np.isfinite(curve.reward).all():
        middle = float(np.median(np.abs(curve.reward)))
        fall = lasting_fall(
            curve.reward, 0.2 * middle, REWARD_FALL, least_noise=max(0.03 * middle, 1e-9)
        )
    return fall, "" if fall is None else "reward"


def _paid(curve: LearningCurve, fall: Fall | None, fallen: str) -> bool:
    if fall is None or fallen != "progress" or not np.isfinite(curve.reward).all():
        return False
    before, after = curve.reward[max(0, fall.at - 5) : fall.at], curve.reward[fall.at :]
    if float(after.mean()) < REWARD_RISE * float(before.mean()) or before.mean() <= 0:
        return False
    return change_t(before, after) >= TREND_T


def _speed_over_track(steps: DrivenSteps) -> float | None:
    together = steps.episode[1:] == steps.episode[:-1]
    way = np.hypot(np.diff(steps.x), np.diff(steps.y))[together]
    time_s = np.diff(steps.time_s)[together]
    fine = np.isfinite(way) & np.isfinite(time_s) & (time_s > 0) & (way < 1.0)
    total_s = float(time_s[fine].sum())
    return float(way[fine].sum()) / total_s if total_s > 0 else None


def _number(values: Mapping[str, object], key: str) -> float | None:
    value = values.get(key)
    if isinstance(value, str):  # some tools write numbers as text
        try:
            value = float(value)
        except ValueError:
            return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)

"""All that verdict and advice rest on, computed once."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.findings.action_use import ActionUse, action_use
from drcli.analysis.findings.discount_horizon import DiscountHorizon, discount_horizon
from drcli.analysis.findings.driven_steps import DrivenSteps, driven_steps
from drcli.analysis.findings.episode_ends import EpisodeEnds, episode_ends
from drcli.analysis.findings.episode_groups import EpisodeGroup, by_quintile, by_start
from drcli.analysis.findings.evaluated_laps import (
    EvaluatedLaps,
    evaluated_alone,
    evaluated_in_training,
)
from drcli.analysis.findings.evaluation_gap import EvaluationGap, evaluation_gap
from drcli.analysis.findings.lap_slowing import change_t, lap_slowing
from drcli.analysis.findings.lap_times import LapTimes, lap_times
from drcli.analysis.findings.learner_health import LearnerHealth, learner_health
from drcli.analysis.findings.learning_curve import (
    TREND_T,
    Fall,
    LearningCurve,
    lasting_fall,
    learning_curve,
)
from drcli.analysis.findings.reward_rate import RewardRate, reward_rate
from drcli.analysis.findings.snaking import Snaking, snaking
from drcli.analysis.findings.steering_balance import SteeringBalance, steering_balance
from drcli.analysis.findings.wheels_off import WheelsOff, wheels_off
from drcli.analysis.findings.window import early_steps, late_steps, learned_steps
from drcli.analysis.run import Run
from drcli.base.json_record import RecordError, parse_json
from drcli.modelfiles.action_space import ActionSpace
from drcli.store.keys import MODEL_METADATA_FILE

if TYPE_CHECKING:
    import pandas as pd

FALL_FROM = 20.0
"""Percent. The warning during a training asks for 40; a whole curve shows smaller falls."""

LEAST_NOISE = 1.5
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
    learned = learned_steps(steps, curve, broken)
    late, early = late_steps(steps, curve, broken), early_steps(steps, curve, broken)
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
            _since_phase(run.learner, curve), sac=is_sac(run), actions=_discrete(run.actions)
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


def is_sac(run: Run) -> bool:
    """Whether a model was trained by SAC.

    sac_alpha does not tell: the reference ships it with hyperparameters of PPO.
    """
    with suppress(RecordError):
        metadata = parse_json(run.files.get(MODEL_METADATA_FILE, "{}").encode())
        if isinstance(metadata, dict) and "training_algorithm" in metadata:
            return bool(metadata["training_algorithm"] == "sac")
    return run.hyperparameters.get("exploration_type") == "additive_noise"


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

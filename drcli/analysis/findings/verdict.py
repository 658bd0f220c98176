"""The verdict on a training: is it improving?"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drcli.analysis.findings.evaluated_laps import EvaluatedLaps
from drcli.analysis.findings.evidence import Evidence
from drcli.analysis.findings.learning_curve import (
    LEAST_GAIN,
    SHORT,
    Decline,
    LearningCurve,
    Slope,
    decline,
    present_trend,
    rise,
    settled_since,
    slope,
    swings,
    window,
)
from drcli.model.alarms import CONVERGED_GAP, CONVERGED_OVER, CONVERGED_PROGRESS
from drcli.model.history import SMOOTH

Kind = Literal[
    "improving",
    "converged",
    "plateau",
    "declining",
    "collapsed",
    "not_learning",
    "too_noisy",
    "too_short",
]


LEAST_ITERATIONS = 4

LEAST_REWARD_GAIN = 0.05

LEAST_LAP_GAIN = 0.02

NOISY = 0.3
"""Mean jump as a share of the mean. Healthy trainings have 0.1 to 0.3 while they learn; `dr-status`
warns from 0.4 on.
"""


TURNS = 0.5
"""Share of the jumps that turn back; by chance 0.67."""


LOW, HIGH = 20.0, 80.0
"""Percent of mean progress."""


NOT_LEARNING = 15


@dataclass(frozen=True)
class Verdict:
    """What became of a training; `since` and `at` are iterations."""

    kind: Kind
    sentence: str
    numbers: dict[str, float]


def judge(evidence: Evidence) -> Verdict:
    found, phase = _judged(evidence), evidence.curve.phase
    if not phase:
        return found
    sentence = f"Phase {phase}: {found.sentence}"
    if phase == "teacher":
        sentence += " That is its teacher; the camera policy learns in the phases that follow."
    return replace(found, sentence=sentence)


def _judged(evidence: Evidence) -> Verdict:
    curve = evidence.curve
    if evidence.fall is not None:
        return _collapsed(evidence)
    if len(curve) < LEAST_ITERATIONS:
        return _too_short(curve)
    lost = decline(curve)
    if lost is not None:
        return _declining(lost)
    trend = present_trend(curve)
    for rule in (_converged_by_evaluations, _improving, _settled):
        found = rule(curve, trend)
        if found is not None:
            return _with_evaluation(found, evidence.evaluated)
    return _too_short(curve)


def _with_evaluation(found: Verdict, newest: EvaluatedLaps | None) -> Verdict:
    if found.kind != "converged" or newest is None or not newest.unclean:
        return found
    laps = newest.laps
    return replace(
        found,
        sentence=f"{found.sentence} But of the laps of the newest evaluation, {laps.clean} of "
        f"{laps.driven} are clean.",
        numbers=found.numbers | {"laps": laps.driven, "clean_laps": laps.clean},
    )


def _collapsed(evidence: Evidence) -> Verdict:
    fall, curve = evidence.fall, evidence.curve
    assert fall is not None
    at = int(curve.iteration[fall.at])
    unit = " %" if evidence.fallen == "progress" else ""
    digits = 0 if evidence.fallen == "progress" or fall.before >= 10 else 2
    paid = " while the reward rose" if evidence.paid else ""
    return Verdict(
        "collapsed",
        f"The policy collapsed at iteration {at}: mean {evidence.fallen} fell from "
        f"{fall.before:.{digits}f}{unit} to {fall.after:.{digits}f}{unit}{paid}, and did not "
        "recover.",
        {"at": at, "before": fall.before, "after": fall.after, "sigmas": fall.sigmas},
    )


def _too_short(curve: LearningCurve) -> Verdict:
    count = len(curve)
    numbers = {"iterations": float(count)}
    if not count:
        return Verdict("too_short", "There is no training episode to judge by.", numbers)
    numbers["progress"] = float(curve.progress[-SMOOTH:].mean())
    word = "iteration is" if count == 1 else "iterations are"
    return Verdict(
        "too_short",
        f"{count} {word} too few to see a trend; mean progress is {numbers['progress']:.0f} %. "
        f"Look again after {max(2 * SHORT, 2 * count)}.",
        numbers,
    )


def _declining(lost: Decline) -> Verdict:
    return Verdict(
        "declining",
        f"It was best near iteration {lost.at} and has become worse since: progress of the "
        f"{lost.what} fell from {lost.best:.0f} % to {lost.now:.0f} %.",
        {"at": lost.at, "before": lost.best, "after": lost.now, "t": lost.t},
    )


def _converged_by_evaluations(curve: LearningCurve, trend: Slope) -> Verdict | None:
    """As `dr-status` says it."""
    where = np.flatnonzero(np.isfinite(curve.evaluation))[-CONVERGED_OVER:]
    if len(where) < CONVERGED_OVER:
        return None
    training, evaluation = curve.progress[where].mean(), curve.evaluation[where].mean()
    if abs(evaluation - training) > CONVERGED_GAP or evaluation < CONVERGED_PROGRESS:
        return None
    if trend.rises and trend.gain >= LEAST_GAIN:
        return None
    since = settled_since(curve)
    return Verdict(
        "converged",
        f"Converged since iteration {since}: training episodes get {training:.0f} % of the lap and "
        f"evaluations {evaluation:.0f} %. There is little left to learn from this reward.",
        {
            "since": since,
            "progress": float(training),
            "evaluation_progress": float(evaluation),
            "trend_t": trend.t,
        },
    )


def _improving(curve: LearningCurve, trend: Slope) -> Verdict | None:
    rising = rise(curve)
    if rising is not None:
        count = rising.count
        middle, half = float(curve.progress[-count:].mean()), rising.gain / 2.0
        return Verdict(
            "improving",
            f"Improving: over the last {count} iterations, mean progress rose from "
            f"{max(0.0, middle - half):.0f} % to {min(100.0, middle + half):.0f} % of the lap. "
            "Keep training.",
            {"iterations": float(count), "gain": rising.gain, "t": rising.t},
        )
    count = window(len(curve))
    if trend.falls and trend.gain <= -LEAST_GAIN:
        return None
    laps = slope(curve.lap_s[-count:])
    if laps.falls and laps.gain <= -LEAST_LAP_GAIN * float(np.nanmean(curve.lap_s[-count:])):
        return Verdict(
            "improving",
            f"Improving: over the last {count} iterations, the mean lap became {-laps.gain:.1f} s "
            "faster. Keep training.",
            {"iterations": float(count), "lap_s_gain": laps.gain, "t": laps.t},
        )
    if len(curve) >= NOT_LEARNING and float(curve.progress[-count:].mean()) < LOW:
        return None  # more reward without more progress is not what it has to learn
    reward, mean = slope(curve.reward[-count:]), float(np.nanmean(np.abs(curve.reward[-count:])))
    if reward.rises and reward.gain >= LEAST_REWARD_GAIN * mean > 0:
        return Verdict(
            "improving",
            f"Improving: over the last {count} iterations, the mean reward rose by "
            f"{100 * reward.gain / mean:.0f} %, while progress stays at "
            f"{curve.progress[-count:].mean():.0f} %.",
            {"iterations": float(count), "reward_gain": reward.gain, "t": reward.t},
        )
    return None


def _settled(curve: LearningCurve, trend: Slope) -> Verdict | None:
    count = window(len(curve))
    level = float(curve.progress[-count:].mean())
    size, turns = swings(curve.progress[-max(count, 2 * SHORT) :])
    numbers = {"iterations": float(len(curve)), "progress": level, "jump": size, "t": trend.t}
    if level < LOW and len(curve) >= NOT_LEARNING:
        return Verdict(
            "not_learning",
            f"Not learning: after {len(curve)} iterations, mean progress is still {level:.0f} % "
            "of the lap.",
            numbers,
        )
    if size >= NOISY and turns >= TURNS and len(curve) >= SHORT:
        return Verdict(
            "too_noisy",
            f"Too noisy to tell: mean progress jumps by {100 * size:.0f} % from one iteration to "
            f"the next, more than it changed in the last {count} iterations.",
            numbers,
        )
    if len(curve) < SHORT:
        return None
    since = settled_since(curve)
    numbers["since"] = since
    evaluation = curve.evaluation[-count:]
    evaluated = float(np.nanmean(evaluation)) if np.isfinite(evaluation).any() else 0.0
    if level >= HIGH or evaluated >= CONVERGED_PROGRESS:
        beside = f" and evaluations {evaluated:.0f} %" if evaluated else ""
        return Verdict(
            "converged",
            f"Converged since iteration {since}: training episodes get {level:.0f} % of the lap"
            f"{beside}, and that no longer changes.",
            {**numbers, "evaluation_progress": evaluated},
        )
    return Verdict(
        "plateau",
        f"No longer improving since iteration {since}: mean progress stays near {level:.0f} % of "
        "the lap.",
        numbers,
    )

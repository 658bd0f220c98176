"""Advice that the learning curve gives."""

import numpy as np

from drcli.analysis.findings.advice_item import TRAIN_ON, Advice, rounded, train_on
from drcli.analysis.findings.curve_trend import (
    LEAST_GAIN,
    UNDER,
    decline,
    rise,
    window,
)
from drcli.analysis.findings.evidence import Evidence, is_sac
from drcli.analysis.findings.reward_advice import REWARD_CHECK
from drcli.analysis.findings.update_advice import LOW_LR, USUAL_LR, lower_lr
from drcli.analysis.findings.verdict import LEAST_ITERATIONS, LOW, NOT_LEARNING

BEHIND, BEHIND_T = 15.0, 3.5
"""In healthy trainings evaluations are ahead of the training episodes, which explore."""


def collapse(evidence: Evidence) -> Advice | None:
    fall, curve = evidence.fall, evidence.curve
    if fall is None:
        return None
    at = int(curve.iteration[fall.at])
    unit = " %" if evidence.fallen == "progress" else ""
    digits = 0 if unit or fall.before >= 10 else 2
    seen = (
        f"Mean {evidence.fallen} was {fall.before:.{digits}f}{unit} before iteration {at} and "
        f"{fall.after:.{digits}f}{unit} since, in {len(curve) - fall.at} iterations. The fall is "
        f"{fall.sigmas:.0f} times as large as chance makes it. "
    )
    numbers = {"iteration": at, "before": fall.before, "after": fall.after, "sigmas": fall.sigmas}
    if evidence.paid:
        first, second = curve.reward[max(0, fall.at - 5) : fall.at], curve.reward[fall.at :]
        return Advice(
            "collapse",
            f"Progress collapsed at iteration {at}, and the reward paid for it",
            f"{seen}But the mean reward rose from {first.mean():.4g} to {second.mean():.4g}: the "
            "car does what it is paid for. Pay for progress.",
            numbers | {"reward_before": float(first.mean()), "reward_after": float(second.mean())},
            "reward_function.py",
            REWARD_CHECK,
        )
    lr = lower_lr(evidence)
    return Advice(
        "collapse",
        f"The policy collapsed at iteration {at}",
        f"{seen}Go back to the best checkpoint, and learn more carefully from there.",
        numbers,
        "lr",
        train_on(f"lr={lr}", checkpoint="best"),
    )


def over_training(evidence: Evidence) -> Advice | None:
    if evidence.fall is not None:
        return None
    lost = decline(evidence.curve)
    if lost is None:
        return None
    return Advice(
        "over-training",
        "Trained for too long",
        f"Progress of the {lost.what} was best near iteration {lost.at} ({lost.best:.0f} % of the "
        f"lap) and is {lost.now:.0f} % now, after {int(evidence.curve.iteration[-1]) - lost.at} "
        "more iterations. The best checkpoint drives better than the last one.",
        {"iteration": lost.at, "before": lost.best, "after": lost.now, "t": lost.t},
        "DR_LOCAL_S3_PRETRAINED_CHECKPOINT",
        train_on(f"lr={lower_lr(evidence)}", checkpoint="best"),
    )


def evaluation_behind(evidence: Evidence) -> Advice | None:
    gap = evidence.gap
    if gap is None or gap.behind < BEHIND or gap.t < BEHIND_T:
        return None
    what = f"the last {gap.count} evaluations" if not gap.alone else f"{gap.count} trials"
    key, usual = ("sac_alpha", 0.1) if is_sac(evidence.run) else ("beta_entropy", 0.01)
    lower = rounded((evidence.number(key) or usual) / 3.0)
    return Advice(
        "evaluation-behind",
        "Evaluations are far behind the training",
        f"Training episodes get {gap.training:.0f} % of the lap, but {what} only "
        f"{gap.evaluation:.0f} %. An evaluation always takes the most likely action, so the "
        "policy gets round by its random actions. Make it surer of itself.",
        {"training": gap.training, "evaluation": gap.evaluation, "behind": gap.behind, "t": gap.t},
        key,
        train_on(f"{key}={lower}"),
    )


def under_training(evidence: Evidence) -> Advice | None:
    curve = evidence.curve
    if evidence.fall is not None or len(curve) < LEAST_ITERATIONS or evidence.level >= UNDER:
        return None
    count = window(len(curve))
    evaluation = curve.evaluation[-count:]
    if np.isfinite(evaluation).any() and float(np.nanmean(evaluation)) >= UNDER:
        return None
    trend = rise(curve)
    if trend is None or curve.laps[-trend.count :].mean() > 0.1:
        return None
    return Advice(
        "under-training",
        "Not trained for long enough",
        f"Mean progress rose by {trend.gain:.0f} points in the last {trend.count} iterations, to "
        f"{evidence.level:.0f} % of the lap, and it has not stopped rising. More training is "
        "likely to help more than any change.",
        {"progress": evidence.level, "gain": trend.gain, "t": trend.t, "iterations": len(curve)},
        *TRAIN_ON,
    )


def not_learning(evidence: Evidence) -> Advice | None:
    curve = evidence.curve
    if evidence.fall is not None or len(curve) < NOT_LEARNING or evidence.level >= LOW:
        return None
    whole = curve.progress
    third = len(whole) // 3
    gained = float(whole[-third:].mean() - whole[:third].mean())
    if gained >= LEAST_GAIN or rise(curve) is not None:
        return None
    lr = evidence.number("lr")
    numbers = {"progress": evidence.level, "gain": gained, "iterations": float(len(curve))}
    seen = (
        f"After {len(curve)} iterations, mean progress is {evidence.level:.0f} % of the lap, and "
        f"was {whole[:third].mean():.0f} % in the first third. "
    )
    if lr is not None and lr <= LOW_LR:
        return Advice(
            "not-learning",
            "The car does not learn",
            f"{seen}A learning rate of {lr:g} hardly changes the weights.",
            {**numbers, "lr": lr},
            "lr",
            train_on(f"lr={rounded(USUAL_LR)}"),
        )
    return Advice(
        "not-learning",
        "The car does not learn",
        f"{seen}Check that driving on earns more than anything else.",
        numbers,
        "reward_function.py",
        "dr-reward check",
    )

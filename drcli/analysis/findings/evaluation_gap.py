"""Progress of evaluations and of training episodes."""

import math
from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.learning_curve import LearningCurve
from drcli.analysis.run import Run

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

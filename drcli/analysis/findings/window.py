"""Which steps show how the car drives now."""

import numpy as np

from drcli.analysis.findings.driven_steps import DrivenSteps
from drcli.analysis.findings.learning_curve import Fall, LearningCurve
from drsim.arrays import Bools

LATE_SHARE = 3
LEAST_STEPS = 1500


def late_steps(steps: DrivenSteps, curve: LearningCurve, fall: Fall | None) -> DrivenSteps:
    """The last third of the iterations, or the third before a collapse."""
    return steps.where(_mask(steps, curve, fall))


def learned_steps(steps: DrivenSteps, curve: LearningCurve, fall: Fall | None) -> DrivenSteps:
    """All steps on the present track before a collapse."""
    if not len(curve):
        return steps
    kept = steps.iteration >= curve.iteration[0]
    if fall is not None:
        kept &= steps.iteration < curve.iteration[fall.at]
    return steps.where(kept)


def early_steps(steps: DrivenSteps, curve: LearningCurve, fall: Fall | None) -> DrivenSteps:
    numbers = curve.iteration if fall is None else curve.iteration[: fall.at]
    if not len(numbers):
        return steps.where(np.zeros(len(steps), dtype=bool))
    last = numbers[max(0, -(-len(numbers) // LATE_SHARE) - 1)]
    return steps.where((steps.iteration >= numbers[0]) & (steps.iteration <= last))


def _mask(steps: DrivenSteps, curve: LearningCurve, fall: Fall | None) -> Bools:
    numbers = curve.iteration if fall is None else curve.iteration[: fall.at]
    if not len(numbers):
        return np.ones(len(steps), dtype=bool)
    counts = np.bincount(np.maximum(steps.iteration, 0), minlength=int(numbers[-1]) + 1)
    counts = counts[numbers[::-1]]
    enough = int(np.searchsorted(np.cumsum(counts), LEAST_STEPS)) + 1
    count = min(len(numbers), max(-(-len(numbers) // LATE_SHARE), enough))
    first, last = numbers[-count], numbers[-1]
    return np.asarray((steps.iteration >= first) & (steps.iteration <= last))

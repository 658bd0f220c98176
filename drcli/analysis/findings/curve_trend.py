"""Trend and decline of a learning curve."""

from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.evidence import LEAST_NOISE
from drcli.analysis.findings.learning_curve import (
    SMOOTH,
    LearningCurve,
    Slope,
    noise,
    rolling,
    slope,
    still_rising,
)
from drsim.arrays import Floats

SHORT = 8

WINDOW_LEAST, WINDOW_MOST = 6, 40

LEAST_GAIN = 2.5
"""Percent of a lap, in that window."""


UNDER = 50.0

DECLINE = 8.0
"""Percent of a lap."""


DECLINE_T = 3.0
"""Of 1,500 made curves that did not decline, 4 reached it; of 400 that lost a quarter or more, 93
%.
"""


ALONE_T = 4.5
"""From this t-value on evaluations, which have few episodes, count alone."""

STRAY = 0.1


@dataclass(frozen=True)
class Decline:
    """A slow loss of mean progress after a best time."""

    what: str
    at: int
    best: float
    now: float
    t: float


def present_trend(curve: LearningCurve) -> Slope:
    return slope(curve.progress[-window(len(curve)) :], LEAST_NOISE)


def rise(curve: LearningCurve) -> Slope | None:
    """The line along which progress still rises; None if not by more than chance.

    Through the newest iterations, or through all if only the whole curve shows it.
    """
    trend = present_trend(curve)
    if trend.rises and trend.gain >= LEAST_GAIN:
        return trend
    low = len(curve) > 0 and float(curve.progress[-window(len(curve)) :].mean()) < UNDER
    if still_rising(curve.progress, LEAST_GAIN if low else 2.0 * LEAST_GAIN, LEAST_NOISE):
        return slope(curve.progress, LEAST_NOISE)
    return None


def window(count: int) -> int:
    return min(count, max(WINDOW_LEAST, min(WINDOW_MOST, -(-count // 2))))


def decline(curve: LearningCurve) -> Decline | None:
    """A slow loss of progress: of the evaluations if enough, else of the training."""
    evaluated = np.flatnonzero(np.isfinite(curve.evaluation))
    if len(evaluated) >= 2 * SHORT:
        found = _decline("evaluations", curve.iteration[evaluated], curve.evaluation[evaluated])
        if found is not None:
            since = curve.progress[curve.iteration >= found.at]
            if found.t >= ALONE_T or slope(since, LEAST_NOISE).t <= -1.0:
                return found
    error = curve.progress_error[np.isfinite(curve.progress_error)]
    chance = float(np.sqrt(np.mean(error**2))) if len(error) else 0.0
    least = max(LEAST_NOISE, chance)  # means of few episodes that seem alike are so by luck
    return _decline("training episodes", curve.iteration, curve.progress, least)


def _decline(
    what: str, number: Floats | np.ndarray, values: Floats, least_noise: float = LEAST_NOISE
) -> Decline | None:
    if len(values) < 10:
        return None
    width = max(SMOOTH, len(values) // 8)
    level = rolling(values, width)
    top = int(np.argmax(level[width - 1 :])) + width - 1
    rest = values[top + 1 :]
    if len(rest) < max(5, len(values) // 5):
        return None
    falling = slope(np.concatenate([values[top - width + 1 : top + 1], rest]), least_noise)
    best, now = float(level[top]), float(np.mean(values[-width:]))
    if best < 30.0 or best - now < DECLINE or falling.t > -DECLINE_T or -falling.gain < DECLINE:
        return None
    return Decline(what, int(number[top - width // 2]), best, now, -falling.t)


def settled_since(curve: LearningCurve) -> int:
    """The iteration from which the progress stays at its level."""
    values = curve.progress
    level = rolling(values, SMOOTH)
    now = float(values[-window(len(values)) :].mean())
    below = level < now - max(2.0 * noise(values) / SMOOTH**0.5, 3.0)
    below_since = np.cumsum(below[::-1])[::-1] / np.arange(len(values), 0, -1)
    settled = np.flatnonzero(~below & (below_since <= STRAY))
    return int(curve.iteration[settled[0] if len(settled) else len(values) - 1])

"""Where a learning curve is going: its present trend, a decline, since when it is settled."""

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
"""A curve of fewer iterations without a clear trend is too short to tell."""


WINDOW_LEAST, WINDOW_MOST = 6, 40
"""Iterations that the present trend is taken from: half of all, within these."""


LEAST_GAIN = 2.5
"""Gain of progress in that window, percent of a lap, that is worth being called progress."""


UNDER = 50.0
"""A training that still improves and is below this mean progress, percent, needs more time. It has
not settled yet, so that a smaller gain over the whole curve counts."""


DECLINE = 8.0
"""Loss of progress since the best time, percent of a lap, that counts as a decline."""


DECLINE_T = 3.0
"""t-value of the straight line from the best time on. The best time was chosen from many, so more
is asked for than of a single trend. Of 1,500 made curves that did not decline, 4 reached it; of 400
that lost a quarter or more, 93 in 100."""


ALONE_T = 4.5
"""t-value from which on evaluations count alone. They have few episodes; otherwise the training
episodes must have fallen with them."""

STRAY = 0.1
"""Share of the later iterations that may be below the level at which a curve has settled."""


@dataclass(frozen=True)
class Decline:
    """A slow loss after a best time.

    Attributes:
        what: Whose progress: of evaluations or of training episodes.
        at: Iteration of the best time.
        best: Mean progress then.
        now: Mean progress of the newest iterations.
        t: t-value of the loss.
    """

    what: str
    at: int
    best: float
    now: float
    t: float


def present_trend(curve: LearningCurve) -> Slope:
    """The trend of the progress of the training episodes in the newest iterations."""
    return slope(curve.progress[-window(len(curve)) :], LEAST_NOISE)


def rise(curve: LearningCurve) -> Slope | None:
    """The line along which progress still rises; None if it does not rise by more than chance.

    It goes through the newest iterations, or through all if only the whole curve shows it. Verdict
    and advice use it alike: no training is "not learning" and advised to train on.
    """
    trend = present_trend(curve)
    if trend.rises and trend.gain >= LEAST_GAIN:
        return trend
    low = len(curve) > 0 and float(curve.progress[-window(len(curve)) :].mean()) < UNDER
    if still_rising(curve.progress, LEAST_GAIN if low else 2.0 * LEAST_GAIN, LEAST_NOISE):
        return slope(curve.progress, LEAST_NOISE)
    return None


def window(count: int) -> int:
    """Iterations that the present trend is taken from."""
    return min(count, max(WINDOW_LEAST, min(WINDOW_MOST, -(-count // 2))))


def decline(curve: LearningCurve) -> Decline | None:
    """A slow loss of progress since a best time.

    That of the evaluations counts first, if there are enough; then that of the training episodes.
    """
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
    """The iteration from which on the progress stays at its present level."""
    values = curve.progress
    level = rolling(values, SMOOTH)
    now = float(values[-window(len(values)) :].mean())
    below = level < now - max(2.0 * noise(values) / SMOOTH**0.5, 3.0)
    below_since = np.cumsum(below[::-1])[::-1] / np.arange(len(values), 0, -1)
    settled = np.flatnonzero(~below & (below_since <= STRAY))
    return int(curve.iteration[settled[0] if len(settled) else len(values) - 1])

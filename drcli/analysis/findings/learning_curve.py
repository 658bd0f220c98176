"""The learning curve of a training, and its statistics."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.run import Run
from drcli.model.history import FALL_SHARE, SMOOTH
from drsim.arrays import Floats, Ints

if TYPE_CHECKING:
    import pandas as pd


FALL_SIGMAS = 4.0
"""Of 1,500 made curves without a collapse, none had so large a fall."""

LEAST_AFTER = 2
TREND_T = 2.6
"""One chance in a hundred."""

HUGE = 1e100
"""Larger values are scaled: their squares overflow."""


@dataclass(frozen=True, eq=False)
class LearningCurve:
    """Means of the iterations that had episodes, oldest first. Every array has shape (n,).

    If the length of the track or the phase changes, only the iterations since are here: before, the
    car had another task, or another driver. Errors are standard errors, NaN for one episode.

    Attributes:
        progress: Percent.
        laps: Share of the episodes that completed the lap.
        evaluation: Mean progress of the evaluation episodes; NaN without.
        phase: Of a training with a teacher; else empty.
    """

    iteration: Ints
    episodes: Ints
    progress: Floats
    progress_error: Floats
    reward: Floats
    reward_error: Floats
    laps: Floats
    evaluation: Floats
    lap_s: Floats
    phase: str = ""

    @property
    def is_own_driving(self) -> bool:
        """Whether the camera policy drives its episodes, and learns from their rewards."""
        return self.phase in ("", "ppo")

    def __len__(self) -> int:
        return len(self.iteration)


@dataclass(frozen=True)
class Fall:
    """A lasting step down of a curve, its height in standard errors."""

    at: int
    before: float
    after: float
    sigmas: float


@dataclass(frozen=True)
class Slope:
    """A line through the newest values, and its t-value."""

    gain: float
    t: float
    count: int

    @property
    def rises(self) -> bool:
        return self.t >= TREND_T

    @property
    def falls(self) -> bool:
        return self.t <= -TREND_T


def learning_curve(run: Run) -> LearningCurve:
    table = run.iterations
    numbers = np.asarray(table.index, dtype=np.int64)
    episodes = _column(table, "episodes")
    kept = np.isfinite(episodes) & (episodes > 0) & np.isfinite(_column(table, "mean_progress"))
    phase, begun = _phase(run)
    kept &= numbers >= max(_since(run), begun)
    count = np.where(kept, episodes, 1.0)
    spread = _progress_spread(run, numbers)
    with np.errstate(invalid="ignore", divide="ignore"):
        return LearningCurve(
            iteration=numbers[kept],
            episodes=count[kept].astype(np.int64),
            progress=_column(table, "mean_progress")[kept],
            progress_error=(spread / np.sqrt(count))[kept],
            reward=_column(table, "mean_reward")[kept],
            reward_error=(_column(table, "std_reward") / np.sqrt(count - 1.0))[kept],
            laps=(np.nan_to_num(_column(table, "complete_laps")) / count)[kept],
            evaluation=_column(table, "eval_mean_progress")[kept],
            lap_s=_column(table, "mean_lap_s")[kept],
            phase=phase,
        )


def noise(values: Floats) -> float:
    """Standard deviation of the chance in a curve, from the differences of neighbours.

    Slow changes cancel out. The median makes it robust against a single step.
    """
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    if not len(steps):
        return 0.0
    if len(steps) < 6:
        return float(np.mean(steps) / 1.128)  # E|a - b| of two normal numbers is 1.128 sigma
    return float(np.median(steps) / (0.6745 * math.sqrt(2.0)))


def rolling(values: Floats, width: int) -> Floats:
    """Moving mean over `width` values, each at the last of them; shorter at first."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    begins = np.maximum(0, ends - width)
    return np.asarray((total[ends] - total[begins]) / (ends - begins))


def slope(values: Floats, least_noise: float = 0.0) -> Slope:
    """A line through values, shape (n,), without NaN."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 3:
        return Slope(0.0, 0.0, len(known))
    x, y = known - known.mean(), values[known]
    rate = float(x @ (y - y.mean()) / (x @ x))
    rest = y - y.mean() - rate * x
    sigma = max(math.sqrt(float(rest @ rest) / (len(x) - 2)), least_noise, 1e-9)
    error = sigma / math.sqrt(float(x @ x))
    return Slope(rate * float(x[-1] - x[0]), rate / error, len(known))


def still_rising(values: Floats, least_gain: float, least_noise: float = 0.0) -> bool:
    """Whether a curve has risen all the time, and its last third more than by chance.

    The last third must be above the one before it, too.
    """
    third = len(values) // 3
    if third < 2:
        return False
    whole = slope(values, least_noise)
    middle, last = values[-2 * third : -third], values[-third:]
    gained = float(last.mean() - middle.mean())
    error = max(noise(values), least_noise) * math.sqrt(2.0 / third)
    return whole.t >= 3.0 and gained >= max(least_gain, error)


def lasting_fall(
    values: Floats, least_before: float, share: float = FALL_SHARE, least_noise: float = 0.0
) -> Fall | None:
    """The step down of a curve of shape (n,) that did not recover.

    It is where two constant levels fit best from the highest moving mean on.
    """
    if len(values) < SMOOTH + LEAST_AFTER + 1 or not np.isfinite(values).all():
        return None
    scale = float(np.abs(values).max())
    if scale > HUGE:
        found = lasting_fall(values / scale, least_before / scale, share, least_noise / scale)
        return found and replace(found, before=found.before * scale, after=found.after * scale)
    top = int(np.argmax(rolling(values, SMOOTH)[SMOOTH - 1 :])) + SMOOTH - 1
    begin = max(0, top - SMOOTH + 1)
    at = _best_split(values, begin)
    if at is None:
        return None
    before = float(np.mean(values[max(0, at - 5) : at]))
    after, end = float(np.mean(values[at:])), float(np.mean(values[at:][-SMOOTH:]))
    if before < least_before or max(after, end) > share * before:
        return None
    first, second = (max(noise(part), least_noise) for part in (values[:at], values[at:]))
    error = math.sqrt(first**2 / min(at, 5) + second**2 / (len(values) - at))
    sigmas = (before - after) / max(error, 1e-9)
    middle = (before + after) / 2.0
    if sigmas < FALL_SIGMAS or _mostly_above(values[at:], middle):
        return None
    if np.mean(values[max(begin, at - 10) : at] < middle) > 0.3:  # it was often so low before
        return None
    return Fall(at, before, after, sigmas)


def swings(values: Floats) -> tuple[float, float]:
    """Mean jump from value to value as a share of their mean, and share of jumps that turn back.

    Of unrelated values, two of three turn back. Equal neighbours do not count.
    """
    jumps = np.diff(values)
    mean = float(np.mean(np.abs(values)))
    if len(jumps) < 2 or mean <= 0:
        return 0.0, 0.0
    ways = np.sign(jumps[jumps != 0.0])
    turns = float(np.mean(ways[1:] != ways[:-1])) if len(ways) >= 2 else 0.0
    drift = abs(float(np.mean(jumps)))  # the median is a whole jump where values alternate
    size = float(np.mean(np.abs(jumps))) - drift
    return max(size, 0.0) / mean, turns


def _best_split(values: Floats, begin: int) -> int | None:
    part = values[begin:]
    ends = np.arange(1, len(part) - LEAST_AFTER + 1)
    if not len(ends):
        return None
    total, squares = np.cumsum(part), np.cumsum(part**2)
    left = squares[ends - 1] - total[ends - 1] ** 2 / ends
    rest = len(part) - ends
    right = (squares[-1] - squares[ends - 1]) - (total[-1] - total[ends - 1]) ** 2 / rest
    return begin + int(ends[np.argmin(left + right)])


def _mostly_above(values: Floats, level: float) -> bool:
    return bool(np.mean(values > level) > 0.2 or np.mean(values[-SMOOTH:]) > level)


def _since(run: Run) -> int:
    steps = run.steps
    if not len(steps):
        return 0
    # Others may drive on tracks of their own.
    steps = steps[steps["worker"] == steps["worker"].min()]
    first = steps.drop_duplicates("iteration", keep="first")
    length = np.asarray(first["track_len"], dtype=np.float64)
    number = np.asarray(first["iteration"], dtype=np.int64)
    known = np.isfinite(length) & (length > 0)
    length, number = length[known], number[known]
    other = np.flatnonzero(np.abs(length - length[-1:]) > 0.05 * length[-1:])
    return int(number[other[-1] + 1]) if len(other) else 0


def _phase(run: Run) -> tuple[str, int]:
    table = run.iterations
    if not len(table) or "phase" not in table:
        return "", 0
    phase = str(table["phase"].iloc[-1])
    others = table.index[table["phase"] != phase]
    return phase, int(others[-1]) + 1 if len(others) else 0


def _progress_spread(run: Run, numbers: Ints) -> Floats:
    episodes = run.episodes
    if not len(episodes):
        return np.full(len(numbers), np.nan)
    spread = episodes.groupby("iteration")["progress"].std()
    return np.asarray(spread.reindex(numbers), dtype=np.float64)


def _column(table: "pd.DataFrame", name: str) -> Floats:
    if name not in table:
        return np.full(len(table), np.nan)
    return np.asarray(table[name], dtype=np.float64)


# Trend and decline of a learning curve.


LEAST_NOISE = 1.5
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

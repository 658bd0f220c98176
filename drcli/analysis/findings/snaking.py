"""Whether a car steers from side to side again and again."""

import math
from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.driven_steps import STEP_S, DrivenSteps
from drsim.arrays import Bools, Floats

SIDE_DEG = 0.5
LONGEST_HALF = 8
"""In steps: 0.53 s. S-bends of a track take longer."""

HARD_SHARE = 0.6
LEAST_STEPS = 200


@dataclass(frozen=True)
class Snaking:
    """How restless the steering is.

    Attributes:
        changes_per_m: Changes of the side, as `dr-status` counts them.
        regularity: Rise of the autocorrelation from half a period to a whole one. 2 is a pure
            swing, 0 is chance; a track gives less than 0.
        period_s: Where it is most regular.
        hard_changes: Share of the steps that go from hard on one side to hard on the other.
        hard_by_chance: The same in a random order.
    """

    changes_per_m: float
    regularity: float
    period_s: float
    amplitude_deg: float
    hard_changes: float
    hard_by_chance: float
    steps: int
    progress: float


def snaking(steps: DrivenSteps) -> Snaking | None:
    known = np.isfinite(steps.steering_deg)
    steps = steps.where(known)
    if len(steps) < LEAST_STEPS:
        return None
    angle, episode = steps.steering_deg, steps.episode
    half, regularity, variance = _regularity(angle, episode)
    most = float(np.percentile(np.abs(angle), 99.0))
    together = episode[1:] == episode[:-1]
    first, second = angle[:-1], angle[1:]
    hard = (first * second < 0) & (np.minimum(np.abs(first), np.abs(second)) >= HARD_SHARE * most)
    hard_changes = float(np.mean(hard[together])) if together.any() else 0.0
    sides = [float(np.mean(angle * side >= HARD_SHARE * most)) for side in (1.0, -1.0)]
    return Snaking(
        changes_per_m=_changes_per_m(steps),
        regularity=regularity,
        period_s=2.0 * half * STEP_S,
        amplitude_deg=math.sqrt(max(0.0, regularity * variance)),
        hard_changes=hard_changes if most > SIDE_DEG else 0.0,
        hard_by_chance=2.0 * sides[0] * sides[1] if most > SIDE_DEG else 0.0,
        steps=len(steps),
        progress=_mean_progress(steps),
    )


def _regularity(angle: Floats, episode: np.ndarray) -> tuple[int, float, float]:
    """Half period with the largest rise of the autocorrelation, that rise, and the variance.

    A sine of period 2h has -1 at h and 1 at 2h. Chance has 0 at both, and slow changes have less
    at 2h.
    """
    level = np.bincount(episode, weights=angle) / np.maximum(1, np.bincount(episode))
    rest = angle - level[episode]
    variance = float(rest @ rest) / len(rest)
    if variance < 1e-6:
        return 1, 0.0, 0.0

    def correlation(lag: int) -> float:
        together: Bools = episode[lag:] == episode[:-lag]
        count = int(together.sum())
        if count < LEAST_STEPS // 2:
            return math.nan
        return float(rest[lag:][together] @ rest[:-lag][together]) / count / variance

    found = [correlation(lag) for lag in range(1, 2 * LONGEST_HALF + 1)]
    rises = [found[2 * half - 1] - found[half - 1] for half in range(1, LONGEST_HALF + 1)]
    best = max(range(len(rises)), key=lambda n: -math.inf if math.isnan(rises[n]) else rises[n])
    return best + 1, 0.0 if math.isnan(rises[best]) else rises[best], variance


def _changes_per_m(steps: DrivenSteps) -> float:
    sided = np.abs(steps.steering_deg) > SIDE_DEG
    side, episode = np.sign(steps.steering_deg[sided]), steps.episode[sided]
    changes = np.count_nonzero((side[1:] != side[:-1]) & (episode[1:] == episode[:-1]))
    together = steps.episode[1:] == steps.episode[:-1]
    way = np.hypot(np.diff(steps.x), np.diff(steps.y))[together]
    metres = float(np.nansum(np.minimum(way, 1.0)))
    return float(changes) / metres if metres > 0 else 0.0


def _mean_progress(steps: DrivenSteps) -> float:
    ends = steps.progress[steps.last]
    return float(np.nanmean(ends)) if np.isfinite(ends).any() else 0.0

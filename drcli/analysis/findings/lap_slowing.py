"""Whether complete laps became slower in time while they earned more."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.findings.learning_curve import TREND_T, LearningCurve
from drcli.analysis.run import Run
from drsim.arrays import Bools, Floats

if TYPE_CHECKING:
    import pandas as pd

SLOWER, SLOWER_T = 0.12, 4.0
"""Laps are slower by at least this share, and so surely. Recorded trainings with a reward for the
centre line became slower by 0.02 to 0.09: a little of it is caution."""

LEAST_LAPS = 12
"""Laps that a comparison needs: four in each third."""


@dataclass(frozen=True)
class LapSlowing:
    """Laps that became slower and earned more: the first third of the laps and the last third.

    Attributes:
        what: Whose laps: "Evaluation laps" or "Training laps".
        laps: How many there are in all.
        early_s: Mean time in the first third, seconds.
        late_s: Mean time in the last third.
        t: t-value of the change of the time.
        early_reward: Mean reward of a lap in the first third.
        late_reward: Mean reward of a lap in the last third.
    """

    what: str
    laps: int
    early_s: float
    late_s: float
    t: float
    early_reward: float
    late_reward: float

    @property
    def sentence(self) -> str:
        """What report and advice print of it."""
        return (
            f"{self.what} became slower: the first third of them took {self.early_s:.1f} s and "
            f"earned {self.early_reward:.4g}, the last third took {self.late_s:.1f} s and earned "
            f"{self.late_reward:.4g}."
        )


def lap_slowing(run: Run, curve: LearningCurve, until: int) -> LapSlowing | None:
    """Compare early and late laps: those of the evaluations during the training, then its own.

    Args:
        run: The training.
        curve: Its learning curve; laps on an earlier track do not count.
        until: Number of iterations of the curve that count: those before a collapse.
    """
    numbers = curve.iteration[:until]
    if not len(numbers):
        return None
    found = None
    if run.records is not None and len(run.records):
        evaluated = run.records[run.records["phase"] == "evaluation"]
        found = _compared("Evaluation laps", evaluated, int(numbers[0]), int(numbers[-1]))
    if found is None:
        found = _compared("Training laps", run.episodes, int(numbers[0]), int(numbers[-1]))
    return found


def _compared(what: str, table: "pd.DataFrame", first: int, last: int) -> LapSlowing | None:
    if not len(table):
        return None
    iteration, time_s, reward = (
        np.asarray(table[name], dtype=np.float64) for name in ("iteration", "time", "reward")
    )
    kept: Bools = np.asarray(table["complete"], dtype=bool) & (time_s > 0) & np.isfinite(reward)
    kept &= (iteration >= first) & (iteration <= last)
    if np.count_nonzero(kept) < LEAST_LAPS:
        return None
    order = np.argsort(iteration[kept], kind="stable")
    time_s, reward = time_s[kept][order], reward[kept][order]
    third = len(time_s) // 3
    t = change_t(time_s[:third], time_s[-third:])
    early_s, late_s = float(time_s[:third].mean()), float(time_s[-third:].mean())
    if late_s < (1.0 + SLOWER) * early_s or t < SLOWER_T:
        return None
    if change_t(reward[:third], reward[-third:]) < TREND_T:
        return None
    return LapSlowing(
        what=what,
        laps=len(time_s),
        early_s=early_s,
        late_s=late_s,
        t=t,
        early_reward=float(reward[:third].mean()),
        late_reward=float(reward[-third:].mean()),
    )


def change_t(early: Floats, late: Floats) -> float:
    """t-value of the change from some values to others; 0 for fewer than two of each.

    A standard error below 0.3 % of the mean is not believed.
    """
    if min(len(early), len(late)) < 2:
        return 0.0
    spread = math.sqrt(float(early.var(ddof=1)) / len(early) + float(late.var(ddof=1)) / len(late))
    floor = 0.003 * abs(float(np.concatenate([early, late]).mean()))
    return float(late.mean() - early.mean()) / max(spread, floor, 1e-9)

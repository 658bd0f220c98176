"""Whether laps became slower while they earned more."""

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
"""Recorded trainings with a reward for the centre line became slower by 0.02 to 0.09."""

LEAST_LAPS = 12


@dataclass(frozen=True)
class LapSlowing:
    """The first and the last third of laps that became slower."""

    what: str
    laps: int
    early_s: float
    late_s: float
    t: float
    early_reward: float
    late_reward: float

    @property
    def sentence(self) -> str:
        return (
            f"{self.what} became slower: the first third of them took {self.early_s:.1f} s and "
            f"earned {self.early_reward:.4g}, the last third took {self.late_s:.1f} s and earned "
            f"{self.late_reward:.4g}."
        )


def lap_slowing(run: Run, curve: LearningCurve, until: int) -> LapSlowing | None:
    """Compare early and late laps, of evaluations first, before `until`."""
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
    """t-value of a change; a standard error below 0.3 % of the mean is not believed."""
    if min(len(early), len(late)) < 2:
        return 0.0
    spread = math.sqrt(float(early.var(ddof=1)) / len(early) + float(late.var(ddof=1)) / len(late))
    floor = 0.003 * abs(float(np.concatenate([early, late]).mean()))
    return float(late.mean() - early.mean()) / max(spread, floor, 1e-9)

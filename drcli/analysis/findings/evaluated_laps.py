"""The newest evaluation: clean laps, bad places, steering."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.findings.action_use import ActionUse, action_use
from drcli.analysis.findings.driven_steps import driven_steps
from drcli.analysis.findings.learning_curve import LearningCurve
from drcli.analysis.findings.steering import SteeringBalance, steering_balance
from drcli.analysis.run import Run, StoredEvaluation
from drcli.records.iteration import Laps
from drcli.records.trace import VIOLATIONS

if TYPE_CHECKING:
    import pandas as pd

CLEAN_SHARE = 0.9
"""Laps are not clean enough if the upper end of the 95 % interval is below: 0 or 1 of 3, 3 of 5,
15 of 20, 31 of 40. The recorded evaluations of the reference have 3 of 3 each.
"""

PARTS = 20
LEAST_TRIALS = 5
"""In evaluations during a training."""


@dataclass(frozen=True)
class BadPlace:
    """The twentieth of the lap where most rules are broken."""

    first: int
    last: int
    count: int
    of: int


@dataclass(frozen=True)
class EvaluatedLaps:
    """The newest evaluation.

    Attributes:
        stamp: Empty for those of the training.
        alone: Mean progress at the first violation or at the end, percent.
    """

    stamp: str
    world: str | None
    laps: Laps
    resets: int
    off_track: int
    crashed: int
    alone: float | None
    place: BadPlace | None
    balance: SteeringBalance | None
    actions: ActionUse | None

    @property
    def unclean(self) -> bool:
        return self.laps.interval[1] < CLEAN_SHARE


def evaluated_alone(run: Run) -> EvaluatedLaps | None:
    """The newest evaluation on its own; None if the training went on after it."""
    if not run.evaluations or not len(run.evaluations[-1].trials):
        return None
    newest = run.evaluations[-1]
    if _ended_s(newest.steps) < _ended_s(run.steps):
        return None
    alone = newest.trials["alone_progress"].dropna()
    steps = driven_steps(newest.steps)
    known = newest.world is None or run.world is None or newest.world == run.world
    return EvaluatedLaps(
        stamp=newest.stamp,
        world=newest.world,
        laps=newest.laps,
        resets=newest.resets,
        off_track=int(newest.trials["off_track"].sum()),
        crashed=int(newest.trials["crashed"].sum()),
        alone=float(alone.mean()) if len(alone) else None,
        place=_place(newest),
        balance=steering_balance(steps, run.track if known else None),
        actions=action_use(steps, steps, run.actions),
    )


def evaluated_in_training(run: Run, curve: LearningCurve) -> EvaluatedLaps | None:
    """The newest evaluations during the training; None if too few."""
    if run.records is None or not len(curve):
        return None
    records = run.records[run.records["phase"] == "evaluation"]
    records = records[records["iteration"] >= curve.iteration[0]]
    if len(records) < LEAST_TRIALS:
        return None
    counts = records.groupby("iteration").size().sort_index()[::-1]
    enough = int((counts.cumsum() < LEAST_TRIALS).sum()) + 1
    newest = records[records["iteration"].isin(counts.index[:enough])]
    status = newest["status"]
    return EvaluatedLaps(
        stamp="",
        world=run.world,
        laps=Laps(len(newest), newest.loc[newest["complete"].astype(bool), "time"].tolist()),
        resets=0,
        off_track=int((status == "off_track").sum()),
        crashed=int((status == "crashed").sum()),
        alone=float(newest["progress"].mean()),
        place=None,
        balance=None,
        actions=None,
    )


def _ended_s(steps: "pd.DataFrame") -> float:
    """Unix seconds; infinite where older simulators do not tell them."""
    ended_s = steps["wall_clock"].max()
    return float(ended_s) if math.isfinite(ended_s) else math.inf


def _place(evaluation: StoredEvaluation) -> BadPlace | None:
    steps = evaluation.steps
    if not len(steps):
        return None
    broken = steps["episode_status"].isin(VIOLATIONS).to_numpy()
    waypoint = steps["closest_waypoint"].to_numpy()
    at = np.sort(waypoint[broken])
    if not len(at):
        return None
    width = (int(waypoint.max()) + 1) / PARTS
    ends = np.searchsorted(at, at + width, side="right")
    begin = int(np.argmax(ends - np.arange(len(at))))
    end = int(ends[begin])
    return BadPlace(int(at[begin]), int(at[end - 1]), end - begin, len(at))

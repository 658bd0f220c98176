"""What the reward pays for: slow driving or fast driving?"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from drcli.analysis.findings.driven_steps import DrivenSteps
from drcli.analysis.findings.learning_curve import TREND_T, LearningCurve
from drcli.analysis.run import Run
from drcli.base.installation import lazy_imports
from drcli.model.files.action_space import ActionSpace
from drsim.arrays import Bools, Floats, Ints

with lazy_imports():
    import pandas as pd

# Whether laps became slower while they earned more.


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


# What the reward pays for.


PARTS, STEPS_IN_PART = 20, 20
"""So that a bend is not compared with a straight. The finer the better: a reward that is only paid
at some places would else seem to be paid for the speed there.
"""

PERIODS = 4
"""So that a beginner is not compared with a good driver."""

LEAST_STEPS = 300
LEAST_EPISODES = 12
LEAST_PROGRESS = 25.0
LAP_POWER, LAP_T = 0.3, 4.0
STEP_POWER, STEP_T = -0.25, -6.0
"""A reward for the centre line has 0. Fast steps leave the line more often (0.01 to 0.06 in the
recorded trainings).
"""

STEEP_LAP_POWER = 1.5
"""The same for each step has 1."""

SPEEDS = 5


@dataclass(frozen=True)
class SpeedPay:
    speed_mps: float
    reward: float
    steps: int


@dataclass(frozen=True)
class RewardRate:
    """What a reward function paid, beside speed and time. None stands for unknown.

    Attributes:
        by_speed: Reward of a step by speed, the slowest first.
        step_power: Reward of a step grows with speed to this power, at the same part of the lap
            and of the training: below 0 slow steps earn more.
        lap_power: Reward of a lap grows with its time to this power: above 0, slow laps earn more.
            A reward of 1 for each step has 1, `reward = speed` has 0.
        complete: Whether `episodes` are complete laps; else each reward is scaled to a lap.
        slow_s: Mean time of the slower half of them, for a lap.
        slowing_t: t-value of the change of the speed; below 0 it became slower.
        pace: The mean speed between the least (0) and the greatest (1) of the actions.
        slower: Laps that became slower and earned more.
    """

    per_step: float
    per_s: float
    per_percent: float | None
    by_speed: tuple[SpeedPay, ...]
    step_power: float | None
    step_t: float | None
    lap_power: float | None
    lap_t: float | None
    episodes: int
    complete: bool
    slow_s: float | None
    fast_s: float | None
    slow_reward: float | None
    fast_reward: float | None
    early_mps: float
    late_mps: float
    slowing_t: float
    pace: float | None
    slower: LapSlowing | None

    @property
    def pays(self) -> str | None:
        """Which laps earn more in all: "slow", "fast" or "same"; None if it cannot be told."""
        power, t = self.lap_power, self.lap_t
        if power is not None and t is not None and abs(t) >= LAP_T and abs(power) >= LAP_POWER:
            return "slow" if power > 0 else "fast"
        if not self.fast_laps_pay and self.slower is not None:
            return "slow"
        if power is None or (self.slow_steps_pay and not self.fast_laps_pay):
            return None
        return "same" if abs(power) <= 0.25 else None

    @property
    def slow_steps_pay(self) -> bool:
        """Whether a slow step surely earns clearly more than a fast one.

        Where complete laps earn less than by an equal reward for each step, places are paid for,
        not speed.
        """
        power, t = self.step_power, self.step_t
        if power is None or t is None or power > STEP_POWER or t > STEP_T:
            return False
        lap, lap_t = self.lap_power, self.lap_t
        if not self.complete or lap is None or not lap_t:
            return True
        return (1.0 - lap) <= LAP_T * abs(lap / lap_t)  # the standard error of a power

    @property
    def slowness_pays(self) -> bool:
        """Whether a slow lap earns clearly and surely more than the same reward for each step.

        Only complete laps show it: the car may be slow just where it drives well.
        """
        power, t = self.lap_power, self.lap_t
        if not self.complete or power is None or t is None or power < STEEP_LAP_POWER:
            return False
        return (power - 1.0) * t >= LAP_T * power  # the standard error of the power is power / t

    @property
    def fast_laps_pay(self) -> bool:
        return self.lap_t is not None and self.lap_t <= -LAP_T


def reward_rate(
    steps: DrivenSteps,
    late: DrivenSteps,
    episodes: "pd.DataFrame",
    space: ActionSpace | None,
    slower: LapSlowing | None = None,
) -> RewardRate | None:
    """Measure what the steps before a collapse were paid for."""
    fine = late.where(np.isfinite(late.reward) & np.isfinite(late.speed_mps))
    if not len(fine):
        return None
    ends = fine.progress[fine.last]
    done = float(np.nansum(ends))
    total = float(fine.reward.sum())
    power, t = _step_power(steps)
    early_mps, late_mps, slowing_t = _slowing(steps)
    return RewardRate(
        per_step=total / len(fine),
        per_s=15.0 * total / len(fine),
        per_percent=total / done if done > 0 else None,
        by_speed=_by_speed(fine),
        step_power=power,
        step_t=t,
        **_laps(episodes, int(steps.iteration.min()), int(steps.iteration.max())),
        early_mps=early_mps,
        late_mps=late_mps,
        slowing_t=slowing_t,
        pace=_pace(late_mps, steps, space),
        slower=slower,
    )


def _step_power(steps: DrivenSteps) -> tuple[float | None, float | None]:
    fine = np.isfinite(steps.reward) & np.isfinite(steps.speed_mps) & steps.on_track & ~steps.last
    if np.count_nonzero(fine) < LEAST_STEPS:
        return None, None
    speed, reward = steps.speed_mps[fine], _without_bonus(steps.reward[fine])
    mean_speed, mean_reward = float(speed.mean()), float(reward.mean())
    if mean_reward <= 0 or mean_speed <= 0:
        return None, None
    cell = _cells(steps.waypoint[fine], steps.iteration[fine])
    count = np.bincount(cell)
    count = np.maximum(1, count)
    v = speed - (np.bincount(cell, weights=speed) / count)[cell]
    r = reward - (np.bincount(cell, weights=reward) / count)[cell]
    moved = float(v @ v)
    if moved / len(v) < (0.03 * mean_speed) ** 2:
        return None, None
    rate = float(v @ r) / moved
    rest = r - rate * v
    error = math.sqrt(max(float(rest @ rest) / len(v) / moved, 1e-18))
    return rate * mean_speed / mean_reward, rate / error


def _without_bonus(reward: Floats) -> Floats:
    low, high = np.percentile(reward, [1.0, 99.0])
    return np.clip(reward, low, high)


def _cells(waypoint: Ints, iteration: Ints) -> Ints:
    places = int(max(waypoint.max(), 0)) + 1
    parts = min(max(PARTS, len(waypoint) // (PERIODS * STEPS_IN_PART)), places)
    place = np.maximum(waypoint, 0) * parts // places
    first, last = int(iteration.min()), int(iteration.max())
    return np.asarray((iteration - first) * PERIODS // (last - first + 1) * parts + place)


def _by_speed(steps: DrivenSteps) -> tuple[SpeedPay, ...]:
    speed = steps.speed_mps
    values = np.unique(np.round(speed, 3))
    if len(values) > SPEEDS:
        edges = np.unique(np.percentile(speed, np.linspace(0.0, 100.0, SPEEDS + 1)[1:-1]))
        group = np.searchsorted(edges, speed, side="right")
    else:
        group = np.searchsorted(values, np.round(speed, 3))
    return tuple(
        SpeedPay(float(speed[at].mean()), float(steps.reward[at].mean()), int(at.sum()))
        for n in np.unique(group)
        if (at := group == n).any()
    )


def _laps(table: "pd.DataFrame", first: int, last: int) -> dict[str, Any]:
    """Reward against time, over laps or long episodes: fields of `RewardRate`."""
    names = ("lap_power", "lap_t", "slow_s", "fast_s", "slow_reward", "fast_reward")
    found: dict[str, Any] = {**dict.fromkeys(names), "episodes": 0, "complete": False}
    if not len(table):
        return found
    iteration = np.asarray(table["iteration"], dtype=np.int64)
    progress, time_s, reward = (
        np.asarray(table[name], dtype=np.float64) for name in ("progress", "time", "reward")
    )
    fine = (iteration >= first) & (iteration <= last)
    fine &= np.isfinite(reward + time_s + progress)
    fine &= (time_s > 0) & (reward > 0) & (progress > 0)
    complete = np.asarray(table["complete"], dtype=bool) & fine
    laps = int(complete.sum()) >= LEAST_EPISODES
    kept = complete if laps else fine & (progress >= LEAST_PROGRESS)
    if int(kept.sum()) < LEAST_EPISODES:
        return found
    share = progress[kept] / 100.0
    time_s, reward = time_s[kept] / share, reward[kept] / share
    slow = time_s >= np.median(time_s)
    found |= {
        "episodes": len(time_s),
        "complete": laps,
        "slow_s": float(time_s[slow].mean()),
        "slow_reward": float(reward[slow].mean()),
    }
    if not slow.all():
        found |= {
            "fast_s": float(time_s[~slow].mean()),
            "fast_reward": float(reward[~slow].mean()),
        }
    x, y = np.log(time_s), np.log(reward)
    central = _central(x) & _central(y)
    x, y = x[central] - x[central].mean(), y[central] - y[central].mean()
    moved = float(x @ x)
    if len(x) >= LEAST_EPISODES and moved / len(x) >= 0.01**2:
        rate = float(x @ y) / moved
        rest = y - rate * x
        error = math.sqrt(max(float(rest @ rest) / max(1, len(x) - 2) / moved, 1e-18))
        found |= {"lap_power": rate, "lap_t": rate / error}
    return found


def _central(values: Floats) -> Bools:
    """Within four robust standard deviations of the median."""
    middle = np.median(values)
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    return np.asarray(np.abs(values - middle) <= max(4.0 * spread, 1e-9))


def _slowing(steps: DrivenSteps) -> tuple[float, float, float]:
    known = np.isfinite(steps.speed_mps)
    number, speed = steps.iteration[known], steps.speed_mps[known]
    values, at = np.unique(number, return_inverse=True)
    means = np.bincount(at, weights=speed) / np.bincount(at)
    part = max(1, len(values) // 3)
    early, late = means[:part], means[-part:]
    return float(early.mean()), float(late.mean()), change_t(early, late)


def _pace(late_mps: float, steps: DrivenSteps, space: ActionSpace | None) -> float | None:
    if space is not None and space.low is not None and space.high is not None:
        slow, fast = space.low[1], space.high[1]
    elif space is not None and space.values:
        speeds = [speed for _, speed in space.values]
        slow, fast = min(speeds), max(speeds)
    else:
        slow, fast = float(np.nanmin(steps.speed_mps)), float(np.nanmax(steps.speed_mps))
    return (late_mps - slow) / (fast - slow) if fast > 1.05 * slow else None


# How long calls of a reward function took.


COLUMNS = {"reward_ms": 1.0, "reward_time_ms": 1.0, "reward_s": 1000.0, "reward_time": 1000.0}
"""Milliseconds in the unit of each column; ours is `reward_ms`."""

_NO_CALL = ("prepare", "pause", "park")


@dataclass(frozen=True)
class RewardFunctionTime:
    calls: int
    p50_ms: float
    p99_ms: float
    total_s: float


def reward_function_time(steps: "pd.DataFrame") -> RewardFunctionTime | None:
    """None if the trace does not have it."""
    for name, unit in COLUMNS.items():
        if name in steps:
            measured = pd.to_numeric(steps[name], errors="coerce")
            values = np.asarray(measured, dtype=np.float64) * unit
            # A call may take less than what the trace can tell.
            called = (values >= 0) & ~np.asarray(steps["episode_status"].isin(_NO_CALL))
            values = values[np.isfinite(values) & called]
            if len(values):
                half, most = np.percentile(values, [50.0, 99.0])
                # Tables hold the column in single precision; more digits would be noise.
                return RewardFunctionTime(
                    len(values),
                    round(float(half), 6),
                    round(float(most), 6),
                    round(float(values.sum()) / 1000.0, 9),
                )
    return None

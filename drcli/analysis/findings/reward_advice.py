"""Advice on what the reward pays for."""

from typing import TYPE_CHECKING

from drcli.analysis.findings.advice_item import Advice
from drcli.analysis.findings.evidence import Evidence
from drcli.analysis.findings.lap_slowing import SLOWER, change_t
from drcli.analysis.findings.learning_curve import TREND_T
from drcli.analysis.findings.reward_rate import RewardRate

if TYPE_CHECKING:
    import pandas as pd

SLOWING_T = -4.0

CRAWL = 0.15

STUCK_SHARE = 0.3

STILL_STEPS, STILL_M = 10, 0.02
"""`immobilized` is not enough: it is also written for a slow car at a limit of steps."""


REWARD_CHECK = "dr-reward check"


def slow_driving(evidence: Evidence) -> Advice | None:
    rate = evidence.rate
    if rate is None:
        return None
    step = rate.slow_steps_pay
    lap = rate.pays == "slow"
    steep = lap and rate.slowness_pays
    change = rate.late_mps / rate.early_mps - 1.0 if rate.early_mps > 0 else 0.0
    slowed = change <= -SLOWER and rate.slowing_t <= SLOWING_T and not _earns_less(evidence)
    crawls = rate.pace is not None and rate.pace <= CRAWL
    harmed = slowed or crawls or rate.slower is not None
    if rate.fast_laps_pay or not (step or steep or (lap and harmed)):
        return None
    numbers = {
        name: float(value)
        for name, value in (
            ("step_power", rate.step_power),
            ("lap_power", rate.lap_power),
            ("slow_reward", rate.slow_reward),
            ("fast_reward", rate.fast_reward),
            ("slow_s", rate.slow_s),
            ("fast_s", rate.fast_s),
            ("early_mps", rate.early_mps),
            ("late_mps", rate.late_mps),
            ("early_lap_s", rate.slower.early_s if rate.slower else None),
            ("late_lap_s", rate.slower.late_s if rate.slower else None),
        )
        if value is not None
    }
    return Advice(
        "slow-driving",
        "The reward pays for slow driving",
        " ".join(_pay_sentences(rate, slowed=slowed, step=step)),
        numbers,
        "reward_function.py",
        REWARD_CHECK,
    )


def _earns_less(evidence: Evidence) -> bool:
    """Then the car did not become slower for the reward."""
    reward = evidence.curve.reward[: evidence.until]
    third = len(reward) // 3
    return third > 0 and change_t(reward[:third], reward[-third:]) <= -TREND_T


def _pay_sentences(rate: RewardRate, *, slowed: bool, step: bool) -> list[str]:
    found = []
    if step and len(rate.by_speed) > 1:
        slow, fast = rate.by_speed[0], rate.by_speed[-1]
        found.append(
            f"A step at {slow.speed_mps:.1f} m/s earns {slow.reward:.3g} on average, one at "
            f"{fast.speed_mps:.1f} m/s {fast.reward:.3g}."
        )
    if rate.fast_s is not None and rate.slow_s is not None and rate.slow_reward is not None:
        what = "Laps" if rate.complete else "Episodes, scaled to a lap,"
        found.append(
            f"{what} of {rate.slow_s:.1f} s earn {rate.slow_reward:.4g} in all, those of "
            f"{rate.fast_s:.1f} s {rate.fast_reward or 0.0:.4g}."
        )
    if slowed:
        found.append(
            f"The requested speed fell from {rate.early_mps:.2f} to {rate.late_mps:.2f} m/s."
        )
    if rate.slower is not None:
        found.append(rate.slower.sentence)
    found.append("Pay more for a lap in fewer steps, such as for the square of the speed.")
    return found


def standing_still(evidence: Evidence) -> Advice | None:
    table = evidence.run.episodes
    if not len(table) or "status" not in table:
        return None
    numbers = evidence.curve.iteration[: evidence.until]
    if not len(numbers):
        return None
    first = numbers[-max(1, len(numbers) // 3)]
    late = table[(table["iteration"] >= first) & (table["iteration"] <= numbers[-1])]
    status = late["status"].astype(str)
    stopped, turns = status == "immobilized", float((status == "reversed").mean())
    if len(late) < 20 or float(stopped.mean()) + turns < STUCK_SHARE:
        return None
    stands = _standing(evidence.run.steps, late.index[stopped]) / len(late)
    if stands + turns < STUCK_SHARE:
        return None
    return Advice(
        "standing-still",
        "The car stands still or turns round",
        f"{100 * stands:.0f} % of the last {len(late)} episodes ended because the car stood, and "
        f"{100 * turns:.0f} % because it drove the wrong way. A reward for every step, whatever it "
        "brings, leads to this. Pay for progress.",
        {"immobilized": stands, "reversed": turns},
        "reward_function.py",
        REWARD_CHECK,
    )


def _standing(steps: "pd.DataFrame", episodes: "pd.Index[int]") -> int:
    if not {"x", "y"} <= set(steps.columns):
        return len(episodes)
    ends = steps[steps["unique_episode"].isin(episodes)].groupby("unique_episode")
    places = ends[["x", "y"]].tail(STILL_STEPS).groupby(steps["unique_episode"])
    moved = (places.max() - places.min()).max(axis="columns")
    return int((moved.isna() | (moved <= STILL_M)).sum())

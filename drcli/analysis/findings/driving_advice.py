"""Advice on how the car steers."""

import shlex
from typing import TYPE_CHECKING

from drcli.analysis.findings.action_use import ActionUse
from drcli.analysis.findings.advice_item import TRAIN_ON, Advice, rounded, train_on
from drcli.analysis.findings.evidence import Evidence, algorithm_of
from drcli.analysis.findings.learning_curve import LEAST_GAIN, TREND_T, present_trend
from drcli.analysis.findings.reward_rate import SLOWER, RewardRate, change_t
from drcli.analysis.findings.steering import SteeringBalance
from drcli.analysis.findings.verdict import NOT_LEARNING

if TYPE_CHECKING:
    import pandas as pd

# Advice on what the reward pays for.


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
    numbers = evidence.curve.iteration[: evidence.until]
    if not len(table) or not len(numbers):
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
    ends = steps[steps["unique_episode"].isin(episodes)].groupby("unique_episode")
    places = ends[["x", "y"]].tail(STILL_STEPS).groupby(steps["unique_episode"])
    moved = (places.max() - places.min()).max(axis="columns")
    return int((moved.isna() | (moved <= STILL_M)).sum())


# Advice on which actions the policy takes.


TOP_SHARE = 0.9

VARIETY = 0.12
"""A new policy has nearly 1; recorded trainings end with 0.5 to 0.8."""


LEARNED = 80.0
"""Percent of mean progress from which a policy may be sure."""


def no_exploration(evidence: Evidence) -> Advice | None:
    use = evidence.actions
    if use is None or evidence.level >= LEARNED or len(use.actions) < 2:
        return None
    trend = present_trend(evidence.curve)
    improving = evidence.fall is None and trend.rises and trend.gain >= LEAST_GAIN
    single = use.top_share >= TOP_SHARE
    known = [spread for spread in (use.variety, evidence.spread) if spread is not None]
    same = bool(known) and min(known) <= VARIETY
    if not single and (not same or improving):
        return None
    numbers = {"top_share": use.top_share, "progress": evidence.level}
    seen = ""
    if use.variety is not None:
        numbers["variety"] = use.variety
        seen = (
            f" At the same place of the lap it varies its actions by {100 * use.variety:.0f} % of "
            "what is possible."
        )
    if evidence.spread is not None:
        numbers["spread"] = evidence.spread
    setting, value = _more_exploration(evidence)
    return Advice(
        "no-exploration",
        "The car no longer tries anything new",
        f"It takes {named(use, use.top)} in {100 * use.top_share:.0f} % of the steps.{seen} But "
        f"it only gets {evidence.level:.0f} % of the lap, so it needs to find something better.",
        numbers,
        setting,
        train_on(f"{setting}={value}"),
    )


def _more_exploration(evidence: Evidence) -> tuple[str, str]:
    key, usual = algorithm_of(evidence.run).entropy
    if key != "beta_entropy":
        return key, rounded(2.0 * (evidence.number(key) or usual))
    beta = evidence.number(key) or 0.0
    return key, rounded(min(0.3, max(usual, 3.0 * beta)))


def dead_actions(evidence: Evidence) -> Advice | None:
    use = evidence.actions
    if use is None or not use.dead:
        return None
    one = len(use.dead) == 1
    names = ", ".join(named(use, number) for number in use.dead)
    counts = sum(use.actions[number].count for number in use.dead)
    seen = f"in {f'only {counts}' if counts else 'none'} of the last {use.steps:,} steps"
    rarest = min(action.share for action in use.actions if action.index not in use.dead)
    where = f" -p {shlex.quote(evidence.run.name)}" if evidence.run.name else ""
    return Advice(
        "dead-action",
        f"{'An action is' if one else 'Some actions are'} dead",
        f"{names[0].upper()}{names[1:]} {'was' if one else 'were'} used {seen}; every other action "
        f"in {100 * rarest:.1f} % or more. A new model without {'it' if one else 'them'} has less "
        "to learn. The number of actions of this model cannot change.",
        {"dead": float(len(use.dead)), "action": float(use.dead[0]), "steps": float(use.steps)},
        "action_space",
        f"dr-action-space from-histogram{where} --write",
    )


def named(use: ActionUse, number: int) -> str:
    action = use.actions[number]
    if use.continuous:
        return f"steering near {action.steering_deg:.0f} degrees at {action.speed_mps:.1f} m/s"
    return f"action {number} ({action.steering_deg:g} degrees, {action.speed_mps:g} m/s)"


OTHER_SIDE, OTHER_NEEDED, AGAINST, DRIFT_DEG = 0.3, 0.08, 0.6, 10.0
"""One-sided: the other side gets at most this share of the steering, at least this share of the
steps is in bends to it, and in at least this share of those it does not steer there; and the
mean surplus is so many degrees times the share of the other side (healthy cars: up to 1.5).
"""


SURPLUS_DEG, HARDLY = 6.0, 0.05
"""Or so large a surplus, with at most this share to the other side."""


BIAS_DEG = 2.0
"""For evaluations that are not clean. Clean ones have up to 1.2 degrees, one with nine resets a
lap 9.7.
"""


REGULAR, SWING_DEG = 0.4, 6.0
"""Recorded trainings have at most 0.22, and that only in slow swings of a second."""


HARD_CHANGES, HARD_ALWAYS, BEYOND_CHANCE = 0.33, 0.45, 1.3
"""Share of steps from hard left to hard right or back, and how many times more than in random
order; from the second share on, the order does not matter.
"""


EVALUATION_CHANGES, EVALUATION_REGULAR, EVALUATION_PROGRESS = 2.0, 0.25, 50.0
"""In a metre, as `dr-status` warns of; a beginner has to zigzag."""


def one_sided(evidence: Evidence) -> Advice | None:
    if _single(evidence.actions):
        return None
    found, newest = _one_sided(evidence, evidence.balance), evidence.evaluated
    if found or newest is None or newest.laps.clean == newest.laps.driven:
        return found
    if _single(newest.actions):
        return None
    return _one_sided(evidence, newest.balance, evaluated=True)


def _single(use: ActionUse | None) -> bool:
    return use is not None and use.top_share >= TOP_SHARE


def _one_sided(
    evidence: Evidence, balance: SteeringBalance | None, *, evaluated: bool = False
) -> Advice | None:
    if balance is None or balance.left + balance.right < 0.1:
        return None
    needed, against, surplus = balance.other_needed, balance.against, balance.surplus_deg
    share = balance.other_share
    drifts = share <= OTHER_SIDE and surplus is not None and surplus >= DRIFT_DEG * share
    avoids = (
        needed is not None
        and needed >= OTHER_NEEDED
        and against is not None
        and against >= AGAINST
        and (share <= HARDLY or drifts)
    )
    biased = evaluated and abs(balance.mean_deg) >= BIAS_DEG
    beyond = (share <= HARDLY or biased) and surplus is not None and surplus >= SURPLUS_DEG
    if not avoids and not beyond:
        return None
    side = balance.side
    other = "right" if side == "left" else "left"
    numbers = {"left": balance.left, "right": balance.right, "mean_deg": balance.mean_deg}
    where = "In the newest evaluation, " if evaluated else ""
    sentences = [
        f"{where}{100 * balance.left:.0f} % of the steps steer to the left and "
        f"{100 * balance.right:.0f} % to the right; on average, the car steers "
        f"{abs(balance.mean_deg):.0f} degrees to the "
        f"{'left' if balance.mean_deg >= 0 else 'right'}."
    ]
    if avoids and needed is not None and against is not None:
        numbers |= {"bends_to_other_side": needed, "against": against}
        sentences.append(
            f"But in {100 * needed:.0f} % of them the track bends to the {other}, and there the "
            f"car does not steer to the {other} in {100 * against:.0f} %."
        )
    elif surplus is not None and balance.needed_deg is not None:
        numbers |= {"needed_deg": balance.needed_deg}
        needed_side = "left" if balance.needed_deg >= 0 else "right"
        sentences.append(
            f"The track needs {abs(balance.needed_deg):.0f} degrees to the {needed_side} there."
        )
    beginner = len(evidence.curve) < NOT_LEARNING
    setting, command = TRAIN_ON if evaluated and beginner else _other_side(evidence, balance)
    return Advice(
        "one-sided-steering",
        f"The car steers {'almost only' if share <= OTHER_SIDE else 'too much'} to the {side}",
        " ".join(sentences),
        numbers,
        setting,
        command,
    )


def _other_side(evidence: Evidence, balance: SteeringBalance) -> tuple[str, str]:
    space = evidence.run.actions
    if space is not None:
        angles = [angle for angle, _ in space.values]
        if space.low is not None and space.high is not None:
            angles = [space.low[0], space.high[0]]
        if angles and (min(angles) >= 0 or max(angles) <= 0):
            return "action_space", "dr-action-space generate --angles 5 --speeds 2 --write"
    setting = "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION"
    return setting, f"dr-config set {setting}=True"


def snakes(evidence: Evidence) -> Advice | None:
    driven, tried = evidence.snaking, evidence.evaluation_snaking
    regular = (
        driven is not None and driven.regularity >= REGULAR and driven.amplitude_deg >= SWING_DEG
    )
    hard = driven is not None and driven.hard_changes >= min(
        HARD_ALWAYS, max(HARD_CHANGES, BEYOND_CHANCE * driven.hard_by_chance)
    )
    zigzags = (
        tried is not None
        and tried.progress >= EVALUATION_PROGRESS
        and tried.changes_per_m > EVALUATION_CHANGES
        and (tried.regularity >= EVALUATION_REGULAR or tried.hard_changes >= HARD_CHANGES / 2)
    )
    shown = tried if zigzags and not (regular or hard) else driven
    if shown is None or not (regular or hard or zigzags):
        return None
    where = "In evaluations, the" if shown is tried else "The"
    sentences = [f"{where} steering changes its side {shown.changes_per_m:.1f} times in a metre."]
    if shown.regularity >= EVALUATION_REGULAR:
        sentences.append(
            f"It swings by {shown.amplitude_deg:.0f} degrees to each side every "
            f"{shown.period_s:.1f} s."
        )
    if shown.hard_changes >= HARD_CHANGES / 2:
        sentences.append(
            f"{100 * shown.hard_changes:.0f} % of the steps go from hard on one side to hard on "
            "the other."
        )
    discount = evidence.number("discount_factor")
    if discount is not None and discount > 0.98:
        setting, command = "discount_factor", train_on("discount_factor=0.97")
    else:
        setting, command = "reward_function.py", REWARD_CHECK
    sentences.append("Reward less steering, or let the car plan less far ahead.")
    return Advice(
        "snaking",
        "The car snakes",
        " ".join(sentences),
        {
            "changes_per_m": shown.changes_per_m,
            "regularity": shown.regularity,
            "amplitude_deg": shown.amplitude_deg,
            "period_s": shown.period_s,
            "hard_changes": shown.hard_changes,
        },
        setting,
        command,
    )

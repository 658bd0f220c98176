"""Advice on how the car steers."""

from drcli.analysis.findings.action_advice import TOP_SHARE
from drcli.analysis.findings.action_use import ActionUse
from drcli.analysis.findings.advice_item import TRAIN_ON, Advice, train_on
from drcli.analysis.findings.evidence import Evidence
from drcli.analysis.findings.reward_advice import REWARD_CHECK
from drcli.analysis.findings.steering_balance import SteeringBalance
from drcli.analysis.findings.verdict import NOT_LEARNING

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

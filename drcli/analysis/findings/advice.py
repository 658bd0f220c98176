"""What a racer should change, the most important first."""

from collections.abc import Callable

from drcli.analysis.findings import (
    action_advice,
    curve_advice,
    evaluation_advice,
    reward_advice,
    steering_advice,
    track_advice,
    update_advice,
)
from drcli.analysis.findings.advice_item import Advice as Advice  # for reports
from drcli.analysis.findings.evidence import Evidence, gather
from drcli.analysis.run import Run

RULES: tuple[tuple[str, Callable[[Evidence], Advice | None]], ...] = (
    ("collapse", curve_advice.collapse),
    ("slow-driving", reward_advice.slow_driving),
    ("one-sided-steering", steering_advice.one_sided),
    ("snaking", steering_advice.snakes),
    ("no-exploration", action_advice.no_exploration),
    ("standing-still", reward_advice.standing_still),
    ("cutting", track_advice.cutting),
    ("over-training", curve_advice.over_training),
    ("evaluation-behind", curve_advice.evaluation_behind),
    ("even-probabilities", update_advice.even_probabilities),
    ("unclean-laps", evaluation_advice.unclean_laps),
    ("unstable", update_advice.unstable),
    ("entropy-rises", update_advice.entropy_rises),
    ("dead-action", action_advice.dead_actions),
    ("one-place", track_advice.hard_place),
    ("short-horizon", update_advice.short_horizon),
    ("not-learning", curve_advice.not_learning),
    ("under-training", curve_advice.under_training),
)
"""Causes come before what follows from them."""

IMPLIED = {
    "slow-driving": {"dead-action", "standing-still"},
    "one-sided-steering": {"dead-action", "no-exploration", "one-place"},
    "snaking": {"dead-action", "no-exploration"},
    "collapse": {"not-learning", "unclean-laps"},
    "evaluation-behind": {"unclean-laps"},
    "no-exploration": {"dead-action", "one-place", "not-learning", "unclean-laps"},
    "even-probabilities": {"not-learning", "unclean-laps"},
    "not-learning": {"unclean-laps"},
    "unclean-laps": {"under-training"},
    "over-training": {"evaluation-behind"},
    "standing-still": {"not-learning"},
}
TAUGHT = ("slow-driving", "standing-still", "cutting")
"""The cause if progress fell and reward rose."""


OF_OWN_LEARNING = {
    "no-exploration",
    "over-training",
    "evaluation-behind",
    "even-probabilities",
    "unclean-laps",
    "unstable",
    "entropy-rises",
    "short-horizon",
    "not-learning",
    "under-training",
}
"""Left out while a teacher learns, or a student from it."""


def advice(run: Run) -> tuple[Advice, ...]:
    """Advice on a training; empty without evidence."""
    return advise(gather(run))


def advise(evidence: Evidence) -> tuple[Advice, ...]:
    rules = [rule for name, rule in RULES if _concerns(name, evidence)]
    found = [item for rule in rules if (item := rule(evidence)) is not None]
    if evidence.paid:
        found.sort(key=lambda item: item.id not in TAUGHT)
    implied = set().union(*(IMPLIED.get(item.id, set()) for item in found))
    return tuple(item for item in found if item.id not in implied)


def _concerns(name: str, evidence: Evidence) -> bool:
    return evidence.curve.is_own_driving or name not in OF_OWN_LEARNING

"""Comparisons of trainings, and which end or are replaced then."""

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drcli.exchange.sweep_record import Resource
from drcli.sweeps.sweep_file import Budget, Choices, EarlyStopping, Span
from drcli.sweeps.trials import rounded

FACTORS = (0.8, 1.25)
"""Jaderberg et al., Population Based Training of Neural Networks (2017), use 0.8 and 1.2."""

REDRAWN = 0.25
"""Probability of a new draw instead."""


def levels_of(budget: Budget, stopping: EarlyStopping) -> list[float]:
    """Amounts of the budget for comparisons; the last is all of it."""
    amounts = [_amount(budget, share) for share in shares_of(stopping)]
    return [*dict.fromkeys(a for a in amounts if a < budget.most), budget.most]


def shares_of(stopping: EarlyStopping) -> list[float]:
    if stopping.method == "none":
        return []
    if stopping.method == "population":
        return [stopping.every * k for k in range(1, math.ceil(1.0 / stopping.every - 1e-9))]
    found: list[float] = []
    share = stopping.first_check
    while share < 1.0:
        found.append(share)
        share *= stopping.reduction_factor
    return found


def share_at(budget: Budget, stopping: EarlyStopping, level: float) -> float:
    """The share of a level; levels are rounded."""
    found = [share for share in shares_of(stopping) if _amount(budget, share) <= level]
    return max(found) if found and level < budget.most else level / budget.most


def _amount(budget: Budget, share: float) -> float:
    amount = budget.most * share
    return amount if budget.resource == "minutes" else float(max(1, round(amount)))


def kept_of(count: int, reduction_factor: float) -> int:
    return max(1, math.ceil(count / reduction_factor - 1e-9))


@dataclass(frozen=True)
class Replacement:
    """The training `name` goes on with the newest weights of `source`."""

    name: str
    source: str
    hyperparameters: Mapping[str, float]


def replacements(
    ranked: Sequence[str],
    own: Mapping[str, Mapping[str, float]],
    vary: Mapping[str, Choices],
    quantile: float,
    chance: random.Random,
) -> list[Replacement]:
    """The worst trainings of a population, each with one of the best to copy.

    `ranked` has the best first; `quantile` is the share replaced, at most half.
    """
    count = min(len(ranked) // 2, max(1, round(len(ranked) * quantile)))
    found = []
    for name in ranked[len(ranked) - count :]:
        source = chance.choice(ranked[:count])
        changed = {key: changed_value(own[source][key], vary[key], chance) for key in own[source]}
        found.append(Replacement(name, source, changed))
    return found


def changed_value(value: float, choices: Choices, chance: random.Random) -> float:
    again = chance.random() < REDRAWN
    if isinstance(choices, Span):
        whole = isinstance(choices.low, int) and isinstance(choices.high, int)
        if again and choices.log:
            drawn = math.exp(chance.uniform(math.log(choices.low), math.log(choices.high)))
        elif again:
            drawn = chance.uniform(choices.low, choices.high)
        else:
            drawn = value * chance.choice(FACTORS)
        kept = min(max(drawn, choices.low), choices.high)
        return round(kept) if whole else rounded(kept)
    numbers = [each for each in choices if not isinstance(each, str)]
    if again or value not in numbers:
        return chance.choice(numbers)
    ordered = sorted(numbers)
    place = ordered.index(value) + chance.choice((-1, 1))
    return ordered[min(max(place, 0), len(ordered) - 1)]


def comparable(resource: Resource, amount: float) -> str:
    if resource == "minutes":
        return f"{amount:.1f} minutes" if amount >= 1.0 else f"{60.0 * amount:.0f} s"
    return f"{amount:,.0f} {resource}"

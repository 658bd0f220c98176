"""Scores of trainings at an amount of their budget."""

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from drcli.model.best_checkpoint import RELIABLE
from drcli.model.history import SMOOTH
from drcli.records.iteration import IterationRecord, share_interval
from drcli.sweeps.sweep_file import Budget, Choices, EarlyStopping, Span
from drcli.sweeps.sweep_record import Metric, Resource, TrialRecord, TrialScore
from drcli.sweeps.trials import rounded

Rank = tuple[float, float, float]
"""Larger is better."""


def amount_of(records: Sequence[IterationRecord], resource: Resource) -> float:
    """Used minutes, steps, episodes or iterations."""
    if not records:
        return 0.0
    episodes = sum(record.episodes for record in records)
    return _used(records[-1], resource, len(records), episodes)


def until(
    records: Sequence[IterationRecord], resource: Resource, amount: float
) -> Sequence[IterationRecord]:
    """The iterations within an amount, and always the first."""
    episodes = 0
    for index, record in enumerate(records):
        episodes += record.episodes
        if _used(record, resource, index + 1, episodes) > amount and index > 0:
            return records[:index]
    return records


def score_of(records: Sequence[IterationRecord], metric: Metric) -> TrialScore | None:
    """None without an iteration."""
    if not records:
        return None
    reward = max(_smoothed([record.mean_reward for record in records]))
    evaluated = [record for record in records if record.evaluation_progress]
    if not evaluated:
        progress = max(_smoothed([record.mean_progress for record in records]))
        return TrialScore(progress=progress, reward=reward)
    scores = [_of_evaluation(record, reward) for record in evaluated]
    return max(scores, key=lambda score: rank(score, metric))


def rank(score: TrialScore | None, metric: Metric) -> Rank:
    """What decides between two trainings.

    By `lap_time` as between checkpoints: the lower bound of the share of clean laps, up to that
    of a reliable checkpoint, then their median time, or without any the progress. Without an
    evaluation, only the progress of training episodes.
    """
    if score is None:
        return (-1.0, 0.0, 0.0)
    reward = score.reward or 0.0
    if metric == "reward":
        return (reward, score.progress, 0.0)
    time = 0.0 if score.lap_s is None else -score.lap_s
    if metric == "progress":
        return (score.progress, time, reward)
    if not score.laps:
        return (0.0, score.progress, reward)
    return (min(RELIABLE, share_interval(score.laps, score.episodes)[0]), time, reward)


def best_of(trials: Sequence[TrialRecord], metric: Metric) -> str:
    """Empty without evaluations, or iterations where reward counts."""
    scored = [
        trial
        for trial in trials
        if trial.score is not None and (trial.score.episodes or metric == "reward")
    ]
    if not scored:
        return ""
    return max(scored, key=lambda trial: rank(trial.score, metric)).name


def _used(record: IterationRecord, resource: Resource, count: int, episodes: int) -> float:
    if resource == "minutes":
        return record.elapsed_s / 60.0
    return float({"steps": record.total_steps, "episodes": episodes, "iterations": count}[resource])


def _of_evaluation(record: IterationRecord, reward: float) -> TrialScore:
    laps = record.all_laps
    assert laps is not None
    return TrialScore(
        checkpoint=record.iteration,  # the evaluation is that of the checkpoint of this number
        laps=laps.clean,
        episodes=laps.driven,
        progress=fmean([*record.evaluation_progress, *record.confirmation_progress]),
        lap_s=laps.median_s,
        reward=reward,
    )


def _smoothed(values: Sequence[float]) -> list[float]:
    window = min(SMOOTH, len(values))
    return [fmean(values[end - window : end]) for end in range(window, len(values) + 1)]


# Comparisons of trainings, and which end or are replaced then.


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

"""Ranks submissions by their laps. Pure functions.

Source of the three rankings: DeepRacer on AWS.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drcli.exchange.race_rules import Ranking
from drcli.exchange.race_submission import DrivenLap


@dataclass(frozen=True)
class LapFigures:
    """Totals of a submission's laps; times are simulated seconds with penalties.

    Attributes:
        complete: With or without resets, as the reference counts them.
        clean: Complete laps without reset and penalty.
        best_lap_s: None without a complete lap.
        best_average_s: Least mean of consecutive complete laps, or None.
        total_s: None if a lap was not completed.
        progress: Percent, summed over all laps.
        best: The laps of `best_lap_s`; `average` those of `best_average_s`.
    """

    driven: int
    complete: int
    clean: int
    in_a_row: int
    best_lap_s: float | None
    best_average_s: float | None
    total_s: float | None
    progress: float
    off_track: int
    crashes: int
    resets: int
    best: Sequence[DrivenLap] = ()
    average: Sequence[DrivenLap] = ()


@dataclass(frozen=True)
class RankingRule:
    """What decides.

    Attributes:
        min_laps: Complete laps needed; in a row for best-average.
    """

    ranking: Ranking
    min_laps: int
    max_laps: int


@dataclass(frozen=True)
class Ranked:
    """A submission in its place; None where it is not qualified."""

    name: str
    rank: int | None
    score_s: float | None
    gap_s: float | None


def figures_of(laps: Sequence[DrivenLap], average_laps: int) -> LapFigures:
    """`average_laps` is the length of the best average."""
    times = [lap.lap_s for lap in laps if lap.complete]
    rows = [
        laps[first : first + average_laps]
        for first in range(len(laps) - average_laps + 1)
        if all(lap.complete for lap in laps[first : first + average_laps])
    ]
    average = min(rows, key=sum_s, default=())
    best = min((lap for lap in laps if lap.complete), key=lambda lap: lap.lap_s, default=None)
    longest = run = 0
    for lap in laps:
        run = run + 1 if lap.complete else 0
        longest = max(longest, run)
    return LapFigures(
        driven=len(laps),
        complete=len(times),
        clean=sum(lap.clean for lap in laps),
        in_a_row=longest,
        best_lap_s=None if best is None else best.lap_s,
        best_average_s=sum_s(average) / average_laps if average else None,
        total_s=math.fsum(times) if laps and len(times) == len(laps) else None,
        progress=math.fsum(lap.progress for lap in laps),
        off_track=sum(lap.off_track for lap in laps),
        crashes=sum(lap.crashes for lap in laps),
        resets=sum(lap.resets for lap in laps),
        best=() if best is None else (best,),
        average=average,
    )


def sum_s(laps: Sequence[DrivenLap]) -> float:
    """Simulated seconds, penalties included."""
    return math.fsum(lap.lap_s for lap in laps)


def score_s(figures: LapFigures, rule: RankingRule) -> float | None:
    """The time that decides; None if not qualified."""
    if rule.ranking == "best-average":
        return figures.best_average_s if figures.in_a_row >= rule.min_laps else None
    if figures.complete < rule.min_laps:
        return None
    if rule.ranking == "total-time":
        return figures.total_s if figures.driven >= rule.max_laps else None
    return figures.best_lap_s


def ranked(submissions: Mapping[str, LapFigures], rule: RankingRule) -> list[Ranked]:
    """All submissions, the best first, with different ranks.

    Equal times (to the millisecond) are decided by the other times, then by fewer violations, then
    by the name, which begins with the time of submission. Those not qualified come last, by
    progress.
    """
    order = sorted(submissions, key=lambda name: _key(name, submissions[name], rule))
    first: float | None = None
    found = []
    for number, name in enumerate(order, start=1):
        score = score_s(submissions[name], rule)
        if score is None:
            found.append(Ranked(name, None, None, None))
            continue
        first = score if first is None else first
        found.append(Ranked(name, number, score, max(0.0, score - first)))
    return found


def best_of_each(
    submissions: Mapping[str, LapFigures], racers: Mapping[str, str], rule: RankingRule
) -> list[Ranked]:
    """The best submission of each racer."""
    best: dict[str, str] = {}
    for place in ranked(submissions, rule):
        best.setdefault(same_racer(racers[place.name]), place.name)
    return ranked({name: submissions[name] for name in best.values()}, rule)


def same_racer(name: str) -> str:
    """Equal for names that differ in capitals and spaces only."""
    return " ".join(name.split()).casefold()


def milliseconds(seconds: float | None) -> float:
    """Without a time, longer than every other."""
    return math.inf if seconds is None else round(seconds * 1000.0)


def _key(name: str, figures: LapFigures, rule: RankingRule) -> tuple[float | str, ...]:
    score = score_s(figures, rule)
    violations = figures.off_track + figures.crashes
    if score is None:
        reached = (-figures.complete, -figures.progress, violations)
        return (1, *reached, 0, 0, name)
    times = (figures.best_average_s, figures.best_lap_s, figures.total_s)
    return (0, milliseconds(score), *map(milliseconds, times), violations, name)

"""Ranks submissions by their laps. Pure functions.

Source of the three rankings: DeepRacer on AWS.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drcli.races.race_records import DrivenLap, Ranking


@dataclass(frozen=True)
class LapFigures:
    """Totals of a submission's laps; times in simulated seconds with penalties, None without laps.

    Attributes:
        complete: With or without resets, as the reference counts.
        clean: Complete laps without reset and penalty.
        total_s: None if a lap was not completed.
        progress: Percent, summed over laps.
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
    """`min_laps` complete laps are needed; in a row for best-average."""

    ranking: Ranking
    min_laps: int
    max_laps: int


@dataclass(frozen=True)
class Ranked:
    """None in a field: not qualified."""

    name: str
    rank: int | None
    score_s: float | None
    gap_s: float | None


def figures_of(laps: Sequence[DrivenLap], average_laps: int) -> LapFigures:
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
    """None if not qualified."""
    if rule.ranking == "best-average":
        return figures.best_average_s if figures.in_a_row >= rule.min_laps else None
    if figures.complete < rule.min_laps:
        return None
    if rule.ranking == "total-time":
        return figures.total_s if figures.driven >= rule.max_laps else None
    return figures.best_lap_s


def ranked(submissions: Mapping[str, LapFigures], rule: RankingRule) -> list[Ranked]:
    """The best first, with different ranks.

    Equal times (to the millisecond) are decided by the other times, then by fewer violations, then
    by the name, which begins with the submission's time. The unqualified come last, by progress.
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
    return " ".join(name.split()).casefold()


def milliseconds(seconds: float | None) -> float:
    """None is longer than every other."""
    return math.inf if seconds is None else round(seconds * 1000.0)


def _key(name: str, figures: LapFigures, rule: RankingRule) -> tuple[float | str, ...]:
    score = score_s(figures, rule)
    violations = figures.off_track + figures.crashes
    if score is None:
        reached = (-figures.complete, -figures.progress, violations)
        return (1, *reached, 0, 0, name)
    times = (figures.best_average_s, figures.best_lap_s, figures.total_s)
    return (0, milliseconds(score), *map(milliseconds, times), violations, name)

"""Pairs and winners of HEAD_TO_MODEL. Pure functions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from drcli.races.lap_ranking import figures_of, milliseconds
from drcli.races.race_records import DrivenLap

WIN, DRAW = 1.0, 0.5


@dataclass(frozen=True)
class Meeting:
    """Two submissions that race each other; None if unknown yet (`waits`), or nobody."""

    round: int
    first: str | None
    second: str | None
    waits: bool = False

    @property
    def pair(self) -> tuple[str, str] | None:
        if self.first is None or self.second is None or self.waits:
            return None
        return self.first, self.second


@dataclass(frozen=True)
class PairTally:
    name: str
    points: float
    wins: int
    draws: int
    losses: int


def pair_name(one: str, other: str) -> str:
    return "_".join(sorted((one, other)))


def winner_of(laps: Sequence[Sequence[DrivenLap]]) -> int | None:
    """Index of the winning car, or None.

    More complete laps win, then less time, then more progress, then fewer violations.
    """
    keys = []
    for driven in laps:
        figures = figures_of(driven, 1)
        times = [lap.lap_s for lap in driven if lap.complete]
        violations = figures.off_track + figures.crashes
        keys.append((-figures.complete, milliseconds(sum(times)), -figures.progress, violations))
    if keys[0] == keys[1]:
        return None
    return 0 if keys[0] < keys[1] else 1


def round_robin(names: Sequence[str]) -> list[Meeting]:
    """Everybody meets everybody once, on both sides about equally often.

    At most once per round (circle method).
    """
    circle: list[str | None] = list(names)
    if len(circle) % 2:
        circle.append(None)
    found = []
    index = {name: number for number, name in enumerate(names)}
    for number in range(1, len(circle)):
        half = len(circle) // 2
        for one, other in zip(circle[:half], reversed(circle[half:]), strict=True):
            if one is None or other is None:
                continue
            low, high = sorted((one, other), key=index.__getitem__)
            swapped = (index[low] + index[high]) % 2 == 0
            first, second = (high, low) if swapped else (low, high)
            found.append(Meeting(number, first, second))
        circle[1:] = [circle[-1], *circle[1:-1]]
    return found


def tally(names: Sequence[str], winners: Mapping[str, str | None]) -> list[PairTally]:
    wins, draws, losses = (dict.fromkeys(names, 0) for _ in range(3))
    for one, other in combinations(names, 2):
        name = pair_name(one, other)
        if name not in winners:
            continue
        winner = winners[name]
        if winner is None:
            draws[one] += 1
            draws[other] += 1
            continue
        wins[winner] += 1
        losses[other if winner == one else one] += 1
    return [
        PairTally(
            name, WIN * wins[name] + DRAW * draws[name], wins[name], draws[name], losses[name]
        )
        for name in names
    ]


def bracket(seeds: Sequence[str | None], winner: Callable[[str, str], str | None]) -> list[Meeting]:
    """The known pairs, round by round; the first seed meets the last.

    The opponent of None goes on without racing, as does the first of too few.
    """
    if len(seeds) < 2:
        return []
    size = 2
    while size < len(seeds):
        size *= 2
    places = [seeds[place] if place < len(seeds) else None for place in _places(size)]
    # Each entry: who comes there, and whether that is known.
    entries: list[tuple[str | None, bool]] = [(name, True) for name in places]
    found: list[Meeting] = []
    number = 1
    while len(entries) > 1:
        after: list[tuple[str | None, bool]] = []
        for (one, one_known), (other, other_known) in zip(entries[::2], entries[1::2], strict=True):
            waits = not (one_known and other_known)
            found.append(Meeting(number, one, other, waits))
            if waits:
                after.append((None, False))
            elif one is None or other is None:
                after.append((one or other, True))
            else:
                won = winner(one, other)
                after.append((won, won is not None))
        entries = after
        number += 1
    return found


def champion(meetings: Sequence[Meeting], winner: Callable[[str, str], str | None]) -> str | None:
    """None before the final was driven."""
    if not meetings or meetings[-1].waits:
        return None
    final = meetings[-1]
    pair = final.pair
    return winner(*pair) if pair is not None else final.first or final.second


def reached(
    meetings: Sequence[Meeting], winner: Callable[[str, str], str | None]
) -> dict[str, int]:
    """Last rounds; one more for the champion."""
    found: dict[str, int] = {}
    for meeting in meetings:
        for name in (meeting.first, meeting.second):
            if name is not None:
                found[name] = max(found.get(name, 0), meeting.round)
    first = champion(meetings, winner)
    if first is not None:
        found[first] = meetings[-1].round + 1
    return found


def _places(size: int) -> list[int]:
    order = [0]
    while len(order) < size:
        count = 2 * len(order)
        order = [seed for low in order for seed in (low, count - 1 - low)]
    return order

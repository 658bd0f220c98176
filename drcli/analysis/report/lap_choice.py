"""Which laps a report shows."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

STEPS = 70_000
"""About 1.6 MB of a report: a training of an hour and a half."""

SHOWN_AT_ONCE = 5
_COARSEST = 4
"""0.27 s, half a metre at 2 m/s."""


@dataclass(frozen=True)
class LapChoice:
    """Laps of a training, by `unique_episode`.

    Attributes:
        fastest: The fastest clean laps; else those that came furthest.
        worst: Those of the last fifth that came least far.
        every: Every n-th step is kept.
    """

    ids: tuple[int, ...]
    fastest: tuple[int, ...]
    worst: tuple[int, ...]
    every: int


def choose_laps(episodes: "pd.DataFrame", most_steps: int = STEPS) -> LapChoice:
    if episodes.empty:
        return LapChoice((), (), (), 1)
    by_merit = episodes.assign(
        lap_s=episodes["time"].where(episodes["complete"].astype(bool), math.inf)
    ).sort_values(["lap_s", "progress"], ascending=[True, False], kind="stable")
    fastest = tuple(by_merit.index[:SHOWN_AT_ONCE].tolist())
    order = episodes.sort_values(["iteration", "episode"], kind="stable")
    late = order.index[-math.ceil(len(order) / 5) :]
    last = by_merit.loc[by_merit.index.isin(late)]
    worst = tuple(last.index[::-1][:SHOWN_AT_ONCE].tolist())
    steps = {int(key): int(value) for key, value in episodes["steps"].items()}
    if sum(steps.values()) <= most_steps:
        return LapChoice(tuple(order.index.tolist()), fastest, worst, 1)
    ranked = [group.index.tolist() for _, group in by_merit.groupby("iteration", sort=True)]
    wanted, every = _rounds(ranked, steps, most_steps, {*fastest, *worst})
    return LapChoice(tuple(i for i in order.index.tolist() if i in wanted), fastest, worst, every)


def _rounds(
    ranked: Sequence[Sequence[int]], steps: dict[int, int], most_steps: int, wanted: set[int]
) -> tuple[set[int], int]:
    """Of each iteration the best and the worst lap, then others, as long as there is room.

    Long trainings keep fewer steps of each lap first, and then skip iterations.
    """
    orders = [_telling(group) for group in ranked]
    needed = sum(steps[lap] for order in orders for lap in order[:2])
    every = min(max(math.ceil(needed / most_steps), 1), _COARSEST)
    room = most_steps * every - sum(steps[lap] for lap in wanted)
    skip = max(math.ceil(needed / max(most_steps * every, 1)), 1)
    kept = orders[::-1][::skip]  # the newest one is always there
    for turn in range(max(map(len, kept))):
        laps = [order[turn] for order in kept if turn < len(order) and order[turn] not in wanted]
        cost = sum(steps[lap] for lap in laps)
        if turn >= 2 and cost > room:
            break
        wanted |= set(laps)
        room -= cost
    return wanted, every


def _telling(ranked: Sequence[int]) -> list[int]:
    order = [ranked[0], ranked[-1], ranked[len(ranked) // 2]]
    for near, far in zip(ranked, reversed(ranked), strict=True):
        order += [near, far]
    return list(dict.fromkeys(order))

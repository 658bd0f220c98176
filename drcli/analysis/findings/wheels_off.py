"""Whether a car gets round with wheels off the track."""

import math
from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.driven_steps import DrivenSteps

ENDING_STEPS = 12
LEAST_PROGRESS = 20.0
LEAST_STEPS = 300
LEAST_LAPS = 5
LEAST_PASSES = 10
SIGMAS = 2.0
"""Steps of an episode are alike, so the number of episodes decides."""


@dataclass(frozen=True)
class OffPlace:
    waypoint: int
    steps: int
    share: float


@dataclass(frozen=True)
class WheelsOff:
    """Shares of steps with a wheel off the track amid driving.

    Attributes:
        sure_share: What `share` surely reaches, as the episodes differ.
        lap_share: The same as `share` in complete laps.
        complete_share: Share of the episodes that are complete laps.
        lap_places_share: In complete laps, at waypoints where most steps are like that.
        places: The worst first; five at most.
        places_share: Share of these steps at waypoints where most are like that.
        reward_share: Mean reward of such a step, as a share of that of the others.
    """

    steps: int
    share: float
    sure_share: float
    lap_share: float | None
    sure_lap_share: float
    complete_share: float
    lap_places_share: float
    places: tuple[OffPlace, ...]
    places_share: float
    reward_share: float | None


def wheels_off(steps: DrivenSteps) -> WheelsOff | None:
    if not len(steps):
        return None
    count = int(steps.episode.max()) + 1
    furthest = np.full(count, -np.inf)
    np.maximum.at(furthest, steps.episode, np.nan_to_num(steps.progress))
    complete = furthest >= 100.0
    lengths = np.bincount(steps.episode, minlength=count)
    first = np.searchsorted(steps.episode, np.arange(count))
    to_end = (first + lengths)[steps.episode] - np.arange(len(steps))
    lap = complete[steps.episode]
    midst = (furthest[steps.episode] >= LEAST_PROGRESS) & (lap | (to_end > ENDING_STEPS))
    driving = steps.where(midst)
    if len(driving) < LEAST_STEPS:
        return None
    off = ~driving.on_track
    at = np.maximum(driving.waypoint, 0)
    visits, offs = np.bincount(at), np.bincount(at, weights=off.astype(np.float64))
    rate = offs / np.maximum(1, visits)
    worst = [n for n in np.argsort(-offs, kind="stable")[:5] if offs[n] > 0]
    often = rate[at] >= 0.5
    laps = steps.where(lap)
    on, beside = driving.reward[~off], driving.reward[off]
    normal = float(np.nanmean(on)) if np.isfinite(on).any() else 0.0
    paid = float(np.nanmean(beside)) / normal if normal > 0 and np.isfinite(beside).any() else None
    return WheelsOff(
        steps=len(driving),
        share=float(off.mean()),
        sure_share=_sure_share(driving, least_episodes=2),
        lap_share=float(np.mean(~laps.on_track)) if len(laps) else None,
        sure_lap_share=_sure_share(laps, least_episodes=LEAST_LAPS),
        complete_share=float(complete[np.isfinite(furthest)].mean()),
        lap_places_share=_lap_places_share(laps, int(np.count_nonzero(complete))),
        places=tuple(OffPlace(int(n), int(visits[n]), float(rate[n])) for n in worst),
        places_share=float(np.mean(often[off])) if off.any() else 0.0,
        reward_share=paid,
    )


def _sure_share(steps: DrivenSteps, *, least_episodes: int) -> float:
    _, episode = np.unique(steps.episode, return_inverse=True)
    lengths = np.bincount(episode)
    count = len(lengths)
    if count < least_episodes:
        return 0.0
    offs = np.bincount(episode, weights=~steps.on_track)
    share = float(offs.sum() / lengths.sum())
    rest = offs - share * lengths
    error = math.sqrt(float(rest @ rest) * count / (count - 1)) / float(lengths.sum())
    return max(0.0, share - SIGMAS * error)


def _lap_places_share(laps: DrivenSteps, count: int) -> float:
    if count < LEAST_LAPS:
        return 0.0
    at = np.maximum(laps.waypoint, 0)
    passes, offs = np.bincount(at), np.bincount(at, weights=~laps.on_track)
    often = (offs >= 0.5 * passes) & (passes >= LEAST_PASSES)
    return float(offs[often].sum() / len(laps))

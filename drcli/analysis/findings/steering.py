"""Whether a car steers to both sides as the track needs."""

import math
from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.driven_steps import DrivenSteps
from drcli.records.trace import STEP_S
from drsim.arrays import Bools, Floats
from drsim.track.track import Track

STRAIGHT_DEG = 2.0
BEND_DEG = 3.0
WHEELBASE_M = 0.217
"""Curvature is tan(steering) divided by this. Fitted to recorded drives."""

UNDERSTEER = 0.091
"""Curvature is less by the factor 1 + this * speed squared. Fitted as well, s2/m2."""

LEAST_STEPS = 30
LEAST_VISITS = 3


@dataclass(frozen=True)
class SteeringBalance:
    """Shares of the steps that steer left and right, beside what the track needs at these speeds.

    Attributes:
        mean_deg: Positive to the left.
        needed_left: Share of the steps where the track bends to the left.
        against: Share of the bends to the other side in which the car does not steer there.
    """

    left: float
    right: float
    mean_deg: float
    needed_deg: float | None
    needed_left: float | None
    needed_right: float | None
    side: str
    against: float | None

    @property
    def other_share(self) -> float:
        both = self.left + self.right
        return min(self.left, self.right) / both if both else 0.5

    @property
    def other_needed(self) -> float | None:
        return self.needed_right if self.side == "left" else self.needed_left

    @property
    def surplus_deg(self) -> float | None:
        """How much more it steers to its side than needed, on average."""
        if self.needed_deg is None:
            return None
        more = self.mean_deg - self.needed_deg
        return more if self.side == "left" else -more


def steering_balance(steps: DrivenSteps, track: Track | None) -> SteeringBalance | None:
    known = np.isfinite(steps.steering_deg)
    if not known.any():
        return None
    steps = steps.where(known)
    angle = steps.steering_deg
    left = float(np.mean(angle > STRAIGHT_DEG))
    right = float(np.mean(angle < -STRAIGHT_DEG))
    side = "left" if float(np.sum(angle)) >= 0 else "right"
    needed = _needed_deg(steps, track)
    if needed is None or np.isfinite(needed).sum() < LEAST_STEPS:
        return SteeringBalance(left, right, float(angle.mean()), None, None, None, side, None)
    there = np.isfinite(needed)
    sign = 1.0 if side == "left" else -1.0
    bends = there & (needed * sign < -BEND_DEG)
    against = np.mean(angle[bends] * sign > -STRAIGHT_DEG) if bends.sum() >= LEAST_STEPS else None
    return SteeringBalance(
        left=left,
        right=right,
        mean_deg=float(angle[there].mean()),
        needed_deg=float(needed[there].mean()),
        needed_left=float(np.mean(needed[there] > BEND_DEG)),
        needed_right=float(np.mean(needed[there] < -BEND_DEG)),
        side=side,
        against=None if against is None else float(against),
    )


def _needed_deg(steps: DrivenSteps, track: Track | None) -> Floats | None:
    if not np.isfinite(steps.x).any():
        return None
    if track is not None and track.closed:
        lines = [track.center, track.center[::-1]]
    else:
        path = _mean_path(steps)
        lines = [] if path is None else [path]
    if not lines or len(lines[0]) < 8:
        return None
    speed = np.nan_to_num(steps.speed_mps, nan=1.0)
    grip = 1.0 + UNDERSTEER * speed**2
    return np.asarray(np.degrees(np.arctan(_driven_curvature(steps, lines) * WHEELBASE_M * grip)))


def _driven_curvature(steps: DrivenSteps, lines: list[Floats]) -> Floats:
    """Curvature at each step's waypoint, positive to the left in the direction that is driven.

    A lap that is driven backwards may be numbered in driving order or not. So each episode takes
    the line, shape (waypoints, 2), that its waypoints are nearest to.
    """
    episode = steps.episode - steps.episode[0]
    together = episode[1:] == episode[:-1]
    moved_x, moved_y = (
        np.nan_to_num(np.concatenate([[0.0], np.where(together, np.diff(at), 0.0)]))
        for at in (steps.x, steps.y)
    )
    result = np.full(len(steps), np.nan)
    nearest = np.full(int(episode[-1]) + 1, np.inf)
    for line in lines:
        at = np.clip(steps.waypoint, 0, len(line) - 1)
        far = np.nan_to_num(np.hypot(steps.x - line[at, 0], steps.y - line[at, 1]))
        tangent = np.nan_to_num(np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0))[at]
        ahead = np.bincount(episode, moved_x * tangent[:, 0] + moved_y * tangent[:, 1])
        distance = np.bincount(episode, far)
        here = (distance < nearest)[episode]
        direction = np.where(ahead < 0, -1.0, 1.0)[episode]
        result = np.where(here, _curvature(line)[at] * direction, result)
        nearest = np.minimum(nearest, distance)
    return result


def _mean_path(steps: DrivenSteps) -> Floats | None:
    """Mean place of the car near each waypoint, else NaN. Shape (waypoints, 2)."""
    fine = np.isfinite(steps.x) & np.isfinite(steps.y) & (steps.waypoint >= 0)
    at = steps.waypoint[fine]
    if not len(at) or at.max() < 8:
        return None
    visits = np.bincount(at).astype(np.float64)
    visits[visits < LEAST_VISITS] = np.nan
    x = np.bincount(at, weights=steps.x[fine]) / visits
    y = np.bincount(at, weights=steps.y[fine]) / visits
    return np.stack([x, y], axis=1)


def _curvature(line: Floats) -> Floats:
    """Curvature at each vertex of a loop, positive to the left, over half a metre each way."""
    whole = np.isfinite(line).all(axis=1)
    kept = np.flatnonzero(whole)
    result = np.full(len(line), np.nan)
    if len(kept) < 8:
        return result
    points = line[kept]
    gap = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    kept, points = kept[gap > 1e-6], points[gap > 1e-6]
    if len(kept) < 8:
        return result
    step = float(np.median(np.hypot(*np.diff(points, axis=0).T)))
    reach = min(max(1, round(0.5 / max(step, 1e-3))), len(points) // 4)
    back, ahead = points - np.roll(points, reach, axis=0), np.roll(points, -reach, axis=0) - points
    turn = np.arctan2(
        back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0], np.sum(back * ahead, axis=1)
    )
    length = (np.hypot(*back.T) + np.hypot(*ahead.T)) / 2.0
    near = length < 3.0 * reach * step  # a gap in the path says nothing about a bend
    result[kept] = np.where(near, turn / np.maximum(length, 1e-6), np.nan)
    for number in np.flatnonzero(~np.isfinite(result) & whole):
        result[number] = result[number - 1]
    return np.asarray(np.clip(result, -1.0 / 0.2, 1.0 / 0.2))


# Whether a car steers from side to side again and again.


SIDE_DEG = 0.5
LONGEST_HALF = 8
"""In steps: 0.53 s. S-bends of a track take longer."""

HARD_SHARE = 0.6
LEAST_STEPS_OF_SNAKING = 200


@dataclass(frozen=True)
class Snaking:
    """How restless the steering is.

    Attributes:
        changes_per_m: Changes of the side, as `dr-status` counts them.
        regularity: Rise of the autocorrelation from half a period to a whole one. 2 is a pure
            swing, 0 is chance; a track gives less than 0.
        period_s: Where it is most regular.
        hard_changes: Share of the steps that go from hard on one side to hard on the other.
        hard_by_chance: The same in a random order.
    """

    changes_per_m: float
    regularity: float
    period_s: float
    amplitude_deg: float
    hard_changes: float
    hard_by_chance: float
    steps: int
    progress: float


def snaking(steps: DrivenSteps) -> Snaking | None:
    known = np.isfinite(steps.steering_deg)
    steps = steps.where(known)
    if len(steps) < LEAST_STEPS_OF_SNAKING:
        return None
    angle, episode = steps.steering_deg, steps.episode
    half, regularity, variance = _regularity(angle, episode)
    most = float(np.percentile(np.abs(angle), 99.0))
    together = episode[1:] == episode[:-1]
    first, second = angle[:-1], angle[1:]
    hard = (first * second < 0) & (np.minimum(np.abs(first), np.abs(second)) >= HARD_SHARE * most)
    hard_changes = float(np.mean(hard[together])) if together.any() else 0.0
    sides = [float(np.mean(angle * side >= HARD_SHARE * most)) for side in (1.0, -1.0)]
    return Snaking(
        changes_per_m=_changes_per_m(steps),
        regularity=regularity,
        period_s=2.0 * half * STEP_S,
        amplitude_deg=math.sqrt(max(0.0, regularity * variance)),
        hard_changes=hard_changes if most > SIDE_DEG else 0.0,
        hard_by_chance=2.0 * sides[0] * sides[1] if most > SIDE_DEG else 0.0,
        steps=len(steps),
        progress=_mean_progress(steps),
    )


def _regularity(angle: Floats, episode: np.ndarray) -> tuple[int, float, float]:
    """Half period with the largest rise of the autocorrelation, that rise, and the variance.

    A sine of period 2h has -1 at h and 1 at 2h. Chance has 0 at both, and slow changes have less
    at 2h.
    """
    level = np.bincount(episode, weights=angle) / np.maximum(1, np.bincount(episode))
    rest = angle - level[episode]
    variance = float(rest @ rest) / len(rest)
    if variance < 1e-6:
        return 1, 0.0, 0.0

    def correlation(lag: int) -> float:
        together: Bools = episode[lag:] == episode[:-lag]
        count = int(together.sum())
        if count < LEAST_STEPS_OF_SNAKING // 2:
            return math.nan
        return float(rest[lag:][together] @ rest[:-lag][together]) / count / variance

    found = [correlation(lag) for lag in range(1, 2 * LONGEST_HALF + 1)]
    rises = [found[2 * half - 1] - found[half - 1] for half in range(1, LONGEST_HALF + 1)]
    best = max(range(len(rises)), key=lambda n: -math.inf if math.isnan(rises[n]) else rises[n])
    return best + 1, 0.0 if math.isnan(rises[best]) else rises[best], variance


def _changes_per_m(steps: DrivenSteps) -> float:
    sided = np.abs(steps.steering_deg) > SIDE_DEG
    side, episode = np.sign(steps.steering_deg[sided]), steps.episode[sided]
    changes = np.count_nonzero((side[1:] != side[:-1]) & (episode[1:] == episode[:-1]))
    together = steps.episode[1:] == steps.episode[:-1]
    way = np.hypot(np.diff(steps.x), np.diff(steps.y))[together]
    metres = float(np.nansum(np.minimum(way, 1.0)))
    return float(changes) / metres if metres > 0 else 0.0


def _mean_progress(steps: DrivenSteps) -> float:
    ends = steps.progress[steps.last]
    return float(np.nanmean(ends)) if np.isfinite(ends).any() else 0.0


# Whether a car gets round with wheels off the track.


ENDING_STEPS = 12
LEAST_PROGRESS = 20.0
LEAST_STEPS_OFF = 300
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
    if len(driving) < LEAST_STEPS_OFF:
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

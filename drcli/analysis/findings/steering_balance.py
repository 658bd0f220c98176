"""Whether a car steers to both sides as the track needs."""

from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.driven_steps import DrivenSteps
from drsim.arrays import Floats
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

"""Which actions a policy uses."""

import math
from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.driven_steps import DrivenSteps
from drcli.model.files.action_space import ActionSpace
from drsim.arrays import Bools, Floats, Ints

PLACES = 40
LEAST_AT_PLACE = 20
DEAD_SHARE = 0.01
"""Of what an action would get if all were used alike."""

RARE_SHARE, GAP = 0.03, 20.0
"""Or below this share, if every other action is so many times as frequent; in healthy trainings at
most 15 times.
"""

ALIVE_SHARE = 0.05
"""Every other action must have it: of a sure policy, shares fall off evenly, and none is dead."""

LEAST_FAIR = 50.0
MOST_ACTIONS = 1000
"""Greater numbers are damage; the console allows 30 actions."""

KEPT_SHARE = 0.02


@dataclass(frozen=True)
class ActionShare:
    index: int
    steering_deg: float
    speed_mps: float
    count: int
    share: float
    early_share: float


@dataclass(frozen=True)
class ActionUse:
    """The actions late in a training; cells of the ranges if `continuous`.

    Attributes:
        dead: Actions that are (almost) never used while all others are.
        kept: Actions that a smaller action space would keep.
        variety: Of the action at the same place of the lap: 0 always the same, 1 all alike.
        top: The action that is used most.
    """

    continuous: bool
    steps: int
    actions: tuple[ActionShare, ...]
    dead: tuple[int, ...]
    kept: tuple[int, ...]
    kept_share: float
    variety: float | None
    early_variety: float | None
    top: int

    @property
    def top_share(self) -> float:
        return self.actions[self.top].share


def action_use(
    late: DrivenSteps, early: DrivenSteps, space: ActionSpace | None
) -> ActionUse | None:
    if not len(late):
        return None
    if late.continuous:
        return _cells(late, early, space)
    late, early = (
        steps.where((steps.action >= 0) & (steps.action < MOST_ACTIONS)) for steps in (late, early)
    )
    if not len(late):
        return None
    size = max(
        space.num_actions if space is not None and not space.continuous else 0,
        int(late.action.max()) + 1,
        int(early.action.max()) + 1 if len(early) else 0,
    )
    pairs = _pairs(late, early, space, size)
    return _use(False, (late, late.action), (early, early.action), pairs)


def _use(
    continuous: bool,
    late: tuple[DrivenSteps, Ints],
    early: tuple[DrivenSteps, Ints],
    pairs: list[tuple[float, float]],
) -> ActionUse:
    size = len(pairs)
    counts = np.bincount(late[1], minlength=size)
    before = np.bincount(early[1], minlength=size)
    share = counts / max(1, counts.sum())
    early_share = before / max(1, before.sum())
    kept = np.flatnonzero(share >= KEPT_SHARE)
    return ActionUse(
        continuous=continuous,
        steps=int(counts.sum()),
        actions=tuple(
            ActionShare(n, *pairs[n], int(counts[n]), float(share[n]), float(early_share[n]))
            for n in range(size)
        ),
        dead=() if continuous else _dead(counts),
        kept=tuple(kept.tolist()),
        kept_share=float(share[kept].sum()),
        variety=_variety(late[0], late[1], size),
        early_variety=_variety(early[0], early[1], size),
        top=int(np.argmax(counts)),
    )


def _dead(counts: Ints) -> tuple[int, ...]:
    fair = counts.sum() / len(counts)
    if fair < LEAST_FAIR or len(counts) < 2:
        return ()
    dead = counts < RARE_SHARE * fair
    if not dead.any() or 2 * dead.sum() > len(counts):
        return ()
    most, least = int(counts[dead].max()), int(counts[~dead].min())
    apart = most < DEAD_SHARE * fair or least >= GAP * most
    return tuple(np.flatnonzero(dead).tolist()) if apart and least >= ALIVE_SHARE * fair else ()


def _variety(steps: DrivenSteps, action: Ints, size: int) -> float | None:
    if not len(steps) or size < 2:
        return None
    places = int(steps.waypoint.max()) + 1
    place = np.maximum(steps.waypoint, 0) * min(PLACES, places) // places
    table = np.bincount(place * size + action, minlength=(int(place.max()) + 1) * size)
    counts = table.reshape(-1, size).astype(np.float64)
    total = counts.sum(axis=1)
    counts, total = counts[total >= LEAST_AT_PLACE], total[total >= LEAST_AT_PLACE]
    if not len(total):
        return None
    share: Floats = counts / total[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        entropy = -np.nansum(np.where(share > 0, share * np.log(share), 0.0), axis=1)
    entropy += ((counts > 0).sum(axis=1) - 1) / (2.0 * total)  # Miller and Madow's correction
    return float(min(1.0, (entropy @ total) / total.sum() / math.log(size)))


def _pairs(
    late: DrivenSteps, early: DrivenSteps, space: ActionSpace | None, size: int
) -> list[tuple[float, float]]:
    found = list(space.values) if space is not None else []
    for number in range(len(found), size):
        pair = (math.nan, math.nan)
        for steps in (late, early):
            where = np.flatnonzero(steps.action == number)[:1]
            if len(where):
                pair = (float(steps.steering_deg[where[0]]), float(steps.speed_mps[where[0]]))
                break
        found.append(pair)
    return found


ANGLES, SPEEDS = 7, 3


def _cells(late: DrivenSteps, early: DrivenSteps, space: ActionSpace | None) -> ActionUse | None:
    pair = np.stack([late.steering_deg, late.speed_mps], axis=1)
    fine: Bools = np.asarray(np.isfinite(pair).all(axis=1))
    if not fine.any():
        return None
    late, pair = late.where(fine), pair[fine]
    known: Bools = np.isfinite(early.steering_deg) & np.isfinite(early.speed_mps)
    early = early.where(known)
    if space is not None and space.low is not None and space.high is not None:
        low, high = np.array(space.low), np.array(space.high)
    else:
        low, high = pair.min(axis=0), pair.max(axis=0)
    size = np.array([ANGLES, SPEEDS])
    width = np.maximum(high - low, 1e-9) / size

    def cell(steps: DrivenSteps) -> Ints:
        values = np.stack([steps.steering_deg, steps.speed_mps], axis=1)
        at = np.clip(((values - low) / width).astype(np.int64), 0, size - 1)
        return np.asarray(at[:, 0] * SPEEDS + at[:, 1], dtype=np.int64)

    middles = [
        (float(low[0] + (a + 0.5) * width[0]), float(low[1] + (s + 0.5) * width[1]))
        for a in range(ANGLES)
        for s in range(SPEEDS)
    ]
    return _use(True, (late, cell(late)), (early, cell(early)), middles)

"""The steps of a training as plain arrays."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.run import Run
from drsim.arrays import Bools, Floats, Ints

if TYPE_CHECKING:
    import pandas as pd

STEP_S = 1.0 / 15.0
"""The car decides 15 times in a simulated second."""

STANDING = ("prepare", "pause", "park", "manual_pause")
"""In these the car does not drive by its action."""


@dataclass(frozen=True, eq=False)
class DrivenSteps:
    """Columns of the steps in which the car drove, sorted as in `Run.steps`. All have shape (n,).

    Attributes:
        episode: From 0 in the order of the frame.
        x: Metres.
        steering_deg: Requested, positive to the left.
        speed_mps: Requested.
        action: -1 where continuous.
        on_track: Whether all wheels were.
        progress: Percent.
        time_s: Simulated.
        last: Whether it is the last of its episode.
        track_m: Length.
    """

    episode: Ints
    iteration: Ints
    x: Floats
    y: Floats
    steering_deg: Floats
    speed_mps: Floats
    action: Ints
    reward: Floats
    on_track: Bools
    progress: Floats
    waypoint: Ints
    time_s: Floats
    last: Bools
    track_m: Floats

    def __len__(self) -> int:
        return len(self.episode)

    @cached_property
    def continuous(self) -> bool:
        return not bool((self.action >= 0).any())

    @cached_property
    def length_m(self) -> float:
        """In most steps; NaN if unknown."""
        known = self.track_m[np.isfinite(self.track_m) & (self.track_m > 0)]
        return float(np.median(known)) if len(known) else float("nan")

    def where(self, mask: Bools) -> "DrivenSteps":
        """Those of a mask, shape (n,)."""
        if mask.all():
            return self  # two million steps take 0.2 GB
        columns = {name: getattr(self, name)[mask] for name in _COLUMNS}
        return DrivenSteps(**columns)


_COLUMNS = tuple(DrivenSteps.__dataclass_fields__)


def driven_steps(frame: "pd.DataFrame") -> DrivenSteps:
    """The driven steps of a frame like `Run.steps`, also of evaluations."""
    moving = _moving(frame)
    key = "unique_episode" if "unique_episode" in frame else "episode"
    named = _numbers(frame, key)[moving]
    starts = np.ones(len(named), dtype=bool)
    starts[1:] = named[1:] != named[:-1]
    number = np.cumsum(starts) - 1
    last = np.ones(len(number), dtype=bool)
    last[:-1] = number[1:] != number[:-1]
    return DrivenSteps(
        episode=number.astype(np.int64),
        iteration=_integers(frame, "iteration")[moving],
        x=_numbers(frame, "x")[moving],
        y=_numbers(frame, "y")[moving],
        steering_deg=_numbers(frame, "steering_angle")[moving],
        speed_mps=_numbers(frame, "speed")[moving],
        action=_integers(frame, "action", missing=-1)[moving],
        reward=_numbers(frame, "reward")[moving],
        on_track=_truths(frame, "on_track")[moving],
        progress=_numbers(frame, "progress")[moving],
        waypoint=_integers(frame, "closest_waypoint")[moving],
        time_s=_numbers(frame, "tstamp")[moving],
        last=last,
        track_m=_numbers(frame, "track_len")[moving],
    )


def driven_in(run: Run) -> DrivenSteps:
    return driven_steps(run.steps)


def _numbers(frame: "pd.DataFrame", name: str) -> Floats:
    if name not in frame:
        return np.full(len(frame), np.nan)
    column = frame[name]
    if column.dtype.kind not in "fiub":
        import pandas as pd

        column = pd.to_numeric(column, errors="coerce")
    values = np.asarray(column, dtype=np.float64)
    endless = np.isinf(values)
    return np.where(endless, np.nan, values) if endless.any() else values


def _integers(frame: "pd.DataFrame", name: str, missing: int = 0) -> Ints:
    values = _numbers(frame, name)
    known = np.isfinite(values)
    return np.where(known, values, missing).astype(np.int64)


def _truths(frame: "pd.DataFrame", name: str) -> Bools:
    if name not in frame:
        return np.ones(len(frame), dtype=bool)
    column = frame[name]
    if column.dtype.kind == "b":
        return np.asarray(column, dtype=bool)
    if column.dtype.kind in "fiu":
        return np.asarray(column != 0, dtype=bool)
    return np.asarray(column.astype(str).str.strip().str.lower() != "false", dtype=bool)


def _moving(frame: "pd.DataFrame") -> Bools:
    if "episode_status" not in frame:
        return np.ones(len(frame), dtype=bool)
    return ~np.asarray(frame["episode_status"].isin(STANDING), dtype=bool)

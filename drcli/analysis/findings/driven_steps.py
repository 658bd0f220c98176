"""The steps of a training as plain arrays."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.run import Run
from drcli.records.trace import STEP_S
from drsim.arrays import Bools, Floats, Ints

if TYPE_CHECKING:
    import pandas as pd

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
    moving = ~np.asarray(frame["episode_status"].isin(STANDING), dtype=bool)
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
        on_track=np.asarray(frame["on_track"], dtype=bool)[moving],
        progress=_numbers(frame, "progress")[moving],
        waypoint=_integers(frame, "closest_waypoint")[moving],
        time_s=_numbers(frame, "tstamp")[moving],
        last=last,
        track_m=_numbers(frame, "track_len")[moving],
    )


def _numbers(frame: "pd.DataFrame", name: str) -> Floats:
    values = np.asarray(frame[name], dtype=np.float64)
    endless = np.isinf(values)
    return np.where(endless, np.nan, values) if endless.any() else values


def _integers(frame: "pd.DataFrame", name: str, missing: int = 0) -> Ints:
    values = _numbers(frame, name)
    return np.where(np.isfinite(values), values, missing).astype(np.int64)


# Where episodes end.


PARTS = 20


@dataclass(frozen=True)
class EndsInPart:
    first: int
    last: int
    ends: int
    passes: int

    @property
    def share(self) -> float:
        return self.ends / self.passes if self.passes else 0.0


@dataclass(frozen=True)
class EpisodeEnds:
    """Ends of the episodes late in a training.

    Attributes:
        parts: Twenty, by waypoints.
        densest: The stretch of a part's length with the most ends. It may begin in the middle of a
            part, so that a place on a border is not cut in half.
    """

    episodes: int
    complete: int
    parts: tuple[EndsInPart, ...]
    worst: int | None
    densest: EndsInPart | None


def episode_ends(late: DrivenSteps) -> EpisodeEnds | None:
    if not len(late):
        return None
    complete = late.progress[late.last] >= 100.0
    places = int(max(late.waypoint.max(), 0)) + 1
    size = min(PARTS, places)
    parts = _stretches(late, complete, places, size, width=1)
    worst = max(range(size), key=lambda n: parts[n].ends)
    shifted = parts if 2 * size > places else _stretches(late, complete, places, 2 * size, width=2)
    densest = max(shifted, key=lambda part: part.ends)
    return EpisodeEnds(
        episodes=int(late.last.sum()),
        complete=int(complete.sum()),
        parts=parts,
        worst=worst if parts[worst].ends else None,
        densest=densest if densest.ends else None,
    )


def _stretches(
    late: DrivenSteps, complete: Bools, places: int, cells: int, width: int
) -> tuple[EndsInPart, ...]:
    cell = np.maximum(late.waypoint, 0) * cells // places
    ends = np.bincount(cell[late.last][~complete], minlength=cells)
    seen = np.zeros((int(late.episode[-1] - late.episode[0]) + 1, cells), dtype=bool)
    seen[late.episode - late.episode[0], cell] = True  # far faster than to sort the pairs
    count = cells - width + 1
    passes = np.any([seen[:, n : n + count] for n in range(width)], axis=0).sum(axis=0)
    return tuple(
        EndsInPart(
            first=-(-n * places // cells),
            last=-(-(n + width) * places // cells) - 1,
            ends=int(ends[n : n + width].sum()),
            passes=int(passes[n]),
        )
        for n in range(count)
    )


# Episodes by start, and by fifths of the training.


START_GROUPS = 10


@dataclass(frozen=True)
class EpisodeGroup:
    """Named by quintile, such as 1st, or waypoints, such as 0-11."""

    name: str
    episodes: int
    mean_progress: float
    complete_share: float
    mean_reward: float
    best_lap_s: float | None


def by_quintile(run: Run) -> tuple[EpisodeGroup, ...]:
    groups = run.episodes.groupby("quintile", observed=True)
    return tuple(_group(str(name), rows) for name, rows in groups)


def by_start(run: Run) -> tuple[EpisodeGroup, ...]:
    """The episodes of the last third, by where they start."""
    table = run.episodes
    if not len(table):
        return ()
    first, last = int(table["iteration"].min()), int(table["iteration"].max())
    late = table[table["iteration"] > last - (last - first + 1) / 3]
    start = np.maximum(np.asarray(late["start_at"].fillna(0), dtype=np.int64), 0)
    places = int(np.nanmax([run.steps["closest_waypoint"].max(), start.max()])) + 1
    size = min(START_GROUPS, places)
    group = start * size // places
    return tuple(
        _group(f"{-(-n * places // size)}-{-(-(n + 1) * places // size) - 1}", late[group == n])
        for n in np.unique(group).tolist()
    )


def _group(name: str, rows: "pd.DataFrame") -> EpisodeGroup:
    done = rows["complete"].astype(bool)
    times = rows["time"][done]
    return EpisodeGroup(
        name=name,
        episodes=len(rows),
        mean_progress=float(rows["progress"].mean()),
        complete_share=float(done.mean()),
        mean_reward=float(rows["reward"].mean()),
        best_lap_s=float(times.min()) if len(times) else None,
    )


# How far ahead the discount factor lets a car plan.


@dataclass(frozen=True)
class DiscountHorizon:
    """The horizon 1 / (1 - discount factor)."""

    discount: float
    steps: float
    seconds: float
    metres: float | None
    lap_steps: float | None
    lap_m: float | None
    lap_share: float | None


def discount_horizon(
    hyperparameters: Mapping[str, object], length_m: float, speed_mps: float | None
) -> DiscountHorizon | None:
    value = hyperparameters.get("discount_factor")
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        return None
    steps = 1.0 / (1.0 - value) if value < 1.0 else math.inf
    lap_m = length_m if math.isfinite(length_m) and length_m > 0 else None
    step_m = speed_mps * STEP_S if speed_mps and math.isfinite(speed_mps) else None
    lap_steps = lap_m / step_m if lap_m and step_m else None
    return DiscountHorizon(
        discount=float(value),
        steps=steps,
        seconds=steps * STEP_S,
        metres=steps * step_m if step_m else None,
        lap_steps=lap_steps,
        lap_m=lap_m,
        lap_share=steps / lap_steps if lap_steps else None,
    )

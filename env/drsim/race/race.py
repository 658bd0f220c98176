"""Kinds of race: rules for obstacles, bot cars and a second racer."""

import math
from dataclasses import dataclass
from typing import Literal

from drsim.errors import require

ObstacleKind = Literal["box_obstacle", "deepracer_box_obstacle", "amazon_box_obstacle", "bot_car"]


@dataclass(frozen=True)
class ObstacleRules:
    """Objects that stand still. The defaults are those of the reference's launcher.

    Attributes:
        count: How many; `positions` win over it.
        min_gap_m: Along the centre line, metres.
        randomize: Draw places and lanes for each episode, instead of even distances and
            alternating lanes.
        positions: Fraction of the lap, 0 .. 1, and lane: -1 outer, else inner.
        reset_behind_m: How far behind an obstacle a car that crashed there goes on, metres.
        mercy: Every so-many-th time at the same obstacle it goes on ahead of it instead; 0: never.
    """

    count: int = 6
    kind: ObstacleKind = "box_obstacle"
    min_gap_m: float = 2.0
    randomize: bool = False
    positions: tuple[tuple[float, float], ...] = ()
    reset_behind_m: float = 1.0
    mercy: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError for a number out of range."""
        for name in ("count", "min_gap_m", "reset_behind_m", "mercy"):
            value = getattr(self, name)
            require(0 <= value < math.inf, name, value, "be 0 or more")
        for fraction, _ in self.positions:
            if not 0.0 <= fraction <= 1.0:
                raise ValueError(f"positions contain {fraction}; a place is 0 to 1 of the lap.")


@dataclass(frozen=True)
class BotRules:
    """Slow cars that keep to a lane. The defaults are those of the reference's launcher.

    Attributes:
        speed_mps: Along the centre line.
        min_gap_m: At the start of an episode, metres.
        randomize: Draw places and lanes for each episode.
        lane_change_time_s: Least and most seconds between changes.
        lane_change_distance_m: Metres that a change takes.
        penalty_s: How long a car's bots stand still after one ran into it.
    """

    count: int = 3
    speed_mps: float = 0.2
    min_gap_m: float = 2.0
    randomize: bool = False
    lane_change: bool = False
    lane_change_time_s: tuple[float, float] = (3.0, 5.0)
    lane_change_distance_m: float = 1.0
    penalty_s: float = 2.0

    def __post_init__(self) -> None:
        """Raise ValueError for a number out of range."""
        for name in ("count", "speed_mps", "min_gap_m", "lane_change_distance_m", "penalty_s"):
            value = getattr(self, name)
            require(0 <= value < math.inf, name, value, "be 0 or more")
        most = f"be at most {_FASTEST_BOT_MPS:g}"
        require(self.speed_mps <= _FASTEST_BOT_MPS, "speed_mps", f"{self.speed_mps:g}", most)
        low_s, high_s = times_s = self.lane_change_time_s
        good = 0.0 <= low_s <= high_s < math.inf
        both = "be the least and the most seconds, in this order"
        require(good, "lane_change_time_s", times_s, both)


@dataclass(frozen=True)
class Race:
    """A kind of race; without any of it, a time trial.

    With 2 `racers`, cars 2i and 2i + 1 of a batch share a track.
    """

    obstacles: ObstacleRules | None = None
    bots: BotRules | None = None
    racers: int = 1

    def __post_init__(self) -> None:
        """Raise ValueError unless there are 1 or 2 racers."""
        if self.racers not in (1, 2):
            raise ValueError(f"racers is {self.racers}; one or two cars share a track.")


TIME_TRIAL = Race()


def race_of_name(name: str) -> Race:
    """A kind of race with the default rules; ValueError for an unknown name."""
    races = {
        "time_trial": TIME_TRIAL,
        "object_avoidance": Race(obstacles=ObstacleRules()),
        "head_to_bot": Race(bots=BotRules()),
    }
    if name not in races:
        raise ValueError(f"{name!r} is not a race; choose one of {', '.join(races)}.")
    return races[name]


_FASTEST_BOT_MPS = 100.0

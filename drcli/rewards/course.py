"""The calls that reward functions are tried with, as one process tells another.

Who only reads them does not load the simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.config.run_config import DriveConfig

with lazy_imports():
    from drcli.drive import build_race

Call = dict[str, Any]
"""Reward parameters."""

LATE = -6
"""Of the samples, the one that is late in a very long episode."""

Manner = Literal["along", "weave", "leave", "ram"]


@dataclass(frozen=True)
class ScriptedDriver:
    """A way to drive. A model's actions limit it: the car is told the nearest one.

    Attributes:
        manner: Along the centre line, from border to border, off the road, or into the next object.
        grip_mps2: Sideways in bends; None keeps the speed.
        laps: Otherwise it ends off the road, at a hit or after `steps`.
        start: From the common start, 0 .. 1 of a lap.
        turned: Drives against the others.
    """

    name: str
    about: str
    manner: Manner
    speed_mps: float
    grip_mps2: float | None = None
    laps: bool = True
    steps: int = 10_000
    start: float = 0.0
    turned: bool = False


STEADY = ScriptedDriver("steady", "follows the centre line at 1.2 m/s", "along", 1.2)
FAST = ScriptedDriver("fast", "follows the centre line at up to 3 m/s", "along", 3.0, grip_mps2=2.0)
"""With actions, up to their greatest speed."""
WEAVING = ScriptedDriver("weaving", "swings from border to border at 1 m/s", "weave", 1.0)
LEAVING = ScriptedDriver("leaving", "leaves the road", "leave", 1.2, laps=False, start=0.3)
STANDING = ScriptedDriver(
    "standing", "asks for the least speed", "along", 0.0, laps=False, steps=60, start=0.5
)
RAMMING = ScriptedDriver("ramming", "drives into what is on the road", "ram", 1.5, laps=False)
_OTHER_WAY = "follows the centre line the other way"
TURNED = ScriptedDriver("turned", _OTHER_WAY, "along", 1.2, laps=False, steps=60, turned=True)


@dataclass(frozen=True)
class Trip:
    """One driver's episode; calls lack waypoints."""

    driver: ScriptedDriver
    calls: list[Call]
    end: str
    progress: float
    seconds: float

    @property
    def whole(self) -> bool:
        return self.progress >= 100.0

    @property
    def on_the_road(self) -> bool:
        """Whole, and the car never had to be put back on the road."""
        mishaps = (call["is_offtrack"] or call["is_crashed"] for call in self.calls)
        return self.whole and not any(mishaps)


@dataclass(frozen=True)
class Course:
    """Calls of all drivers, and of places on and off the road.

    Attributes:
        waypoints: By `is_reversed`. Shape (2, n, 2).
        places: Offset by offset, without waypoints.
        off: All wheels are off the road. Shape (offsets, n).
    """

    world: str
    race_type: str
    reversed: bool
    length_m: float
    waypoints: list[list[tuple[float, float]]]
    trips: list[Trip]
    places: list[Call]
    off: list[list[bool]]

    @property
    def sequences(self) -> list[list[Call]]:
        """The drivers' first, then the places."""
        return [*(trip.calls for trip in self.trips), self.places]

    def trip(self, driver: ScriptedDriver) -> Trip:
        return trip_of(self.trips, driver)


def trip_of(trips: Sequence[Trip], driver: ScriptedDriver) -> Trip:
    return next(trip for trip in trips if trip.driver.name == driver.name)


def position(call: Call) -> str:
    side = "left" if call["is_left_of_center"] else "right"
    return (
        f"{call['progress']:.1f} % of the lap, {call['distance_from_center']:.2f} m {side} of the "
        "centre line"
    )


def require_trainable(config: DriveConfig) -> None:
    """SettingsError if nothing can be trained for this race."""
    if (problem := config.untrainable) is not None:
        remedy = "Choose the race to train for, as in DR_RACE_TYPE=TIME_TRIAL dr-reward ..."
        raise SettingsError(str(problem), remedy=remedy)


def each_race(races: Sequence[DriveConfig]) -> list[DriveConfig]:
    """Distinct, the first worker's first."""
    if len(races) == 1:
        return [*races]
    distinct: dict[tuple[object, ...], DriveConfig] = {}
    for own in races:
        driving = (own.train_start_position_offset, own.train_alternate_driving_direction)
        race = (own.world_name, build_race.race_of(own), own.train_reverse_direction)
        distinct.setdefault((race, driving), own)
    return list(distinct.values())

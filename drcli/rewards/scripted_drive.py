"""Lets scripted drivers drive on the configured track and records the reward parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.config.settings import RaceConfig
from drcli.rewards.drivers import (
    FAST,
    LEAVING,
    RAMMING,
    STANDING,
    STEADY,
    TURNED,
    WEAVING,
    Navigator,
    ScriptedDriver,
)
from drcli.workers.build_race import load_race, load_world, race_of
from drsim.car.car import CONTROL_HZ
from drsim.episode.episode import EpisodeRules, Status
from drsim.episode.reward import RewardFunction, RewardParams
from drsim.episode.simulation import Simulation
from drsim.race.race import TIME_TRIAL, Race
from drsim.track.track import Track

_FORGIVEN = 1_000
"""Resets that a lap survives: it has to be a whole one, whatever is on the road."""

_SLOWEST_LAP_MPS = 0.4
"""A lap that would take longer than at this speed is given up."""


@dataclass(frozen=True)
class Trip:
    """One driver's episode.

    Attributes:
        driver: Who drove.
        calls: The reward parameters of each step, without the waypoints.
        end: How it ended, in the words of traces.
        progress: Percent of the lap, at its end.
        mishaps: How often the car was put back on the road.
    """

    driver: ScriptedDriver
    calls: list[RewardParams]
    end: str
    progress: float
    mishaps: int

    @property
    def whole(self) -> bool:
        """Whether the lap was completed."""
        return self.progress >= 100.0

    @property
    def seconds(self) -> float:
        """How long it took."""
        return len(self.calls) / CONTROL_HZ


@dataclass(frozen=True)
class Drive:
    """The trips of all drivers on one track.

    Attributes:
        track: The track as it is driven.
        world: Its name in the config.
        race: What else is on it.
        race_type: Its name in the config.
        trips: One for each driver.
    """

    track: Track
    world: str
    race: Race
    race_type: str
    trips: list[Trip]

    def trip(self, driver: ScriptedDriver) -> Trip:
        """The trip of a driver that took part."""
        return next(trip for trip in self.trips if trip.driver == driver)

    @property
    def start_fraction(self) -> float:
        """Where on the lap the drivers of whole laps started, 0 .. 1."""
        first = self.trip(STEADY).calls[0]
        travelled = first["progress"] / 100.0
        return float((first["projection_distance"] / self.track.length_m - travelled) % 1.0)

    def waypoints(self) -> dict[bool, list[tuple[float, float]]]:
        """The parameter `waypoints`, which `calls` leaves out, by `is_reversed`."""
        return {track.reverse: track.waypoints for track in (self.track, self.track.reversed())}


def each_race(races: Sequence[RaceConfig]) -> list[RaceConfig]:
    """The race of the first worker, and those of the others whose track or race differs."""
    distinct: dict[tuple[object, ...], RaceConfig] = {}
    for own in races:
        what = (own.world_name, race_of(own), own.train_reverse_direction)
        how = (own.train_start_position_offset, own.train_alternate_driving_direction)
        distinct.setdefault((*what, *how), own)
    return list(distinct.values())


def drive(config: RaceConfig) -> Drive:
    """Let all drivers drive on the track and in the race of a worker.

    Raises:
        SettingsError: There is no such track, or the race does not fit on it.
    """
    if (problem := config.untrainable) is not None:
        remedy = "Choose the race to train for, as in DR_RACE_TYPE=TIME_TRIAL dr-reward ..."
        raise SettingsError(str(problem), remedy=remedy)
    track = load_world(config)
    race = load_race(config, track)
    drivers = [STEADY, FAST, WEAVING, LEAVING, STANDING]
    if race != TIME_TRIAL:
        drivers.append(RAMMING)
    if config.train_alternate_driving_direction:
        drivers.append(TURNED)
    trips = _trips(
        track,
        _merciful(race),
        drivers,
        start=config.train_start_position_offset,
        reverse=config.train_reverse_direction,
    )
    driven = track.reversed() if config.train_reverse_direction else track
    return Drive(driven, config.world_name, race, config.race_type, trips)


def _merciful(race: Race) -> Race:
    """The race with rules by which no obstacle can stop a driver for ever."""
    if race.obstacles is None:
        return race
    return replace(race, obstacles=replace(race.obstacles, mercy=1))


def _trips(
    track: Track, race: Race, drivers: list[ScriptedDriver], *, start: float, reverse: bool
) -> list[Trip]:
    directions = (track, track.reversed())
    backward = np.array([reverse != driver.turned for driver in drivers])
    navigators = [
        Navigator(driver, directions[way])
        for driver, way in zip(drivers, backward.tolist(), strict=True)
    ]
    told: list[list[RewardParams]] = [[] for _ in drivers]
    max_steps = int(track.length_m / _SLOWEST_LAP_MPS * CONTROL_HZ)
    simulation = Simulation(
        track,
        num_cars=len(drivers),
        reward_function=[_recorder(calls) for calls in told],
        rules=replace(EpisodeRules(), max_resets=_FORGIVEN, max_steps=max_steps),
        race=race,
    )
    cars = np.arange(len(drivers))
    starts = np.array([start + driver.start for driver in drivers])
    ends = ["in_progress"] * len(drivers)
    try:
        # The same seed puts the same objects before all of them.
        simulation.reset(cars, starts, reverse=backward, seeds=np.ones(len(drivers), np.uint64))
        progress, resets = np.zeros(len(drivers)), np.zeros(len(drivers), np.int64)
        running = np.ones(len(drivers), np.bool_)
        while running.any():
            asked = _requests(navigators, told)
            known = [len(calls) for calls in told]
            result = simulation.step(asked[:, 0], asked[:, 1])
            for car, driver in enumerate(drivers):
                if not running[car]:
                    del told[car][known[car] :]  # its trip had ended before
                    continue
                progress[car], resets[car] = result.progress[car], result.resets[car]
                ends[car] = Status(result.status[car]).label
                mishap = not driver.laps and resets[car] > 0
                enough = len(told[car]) >= driver.steps
                running[car] = not (result.done[car] or mishap or enough)
    finally:
        simulation.close()
    return [
        Trip(*facts)
        for facts in zip(drivers, told, ends, progress.tolist(), resets.tolist(), strict=True)
    ]


def _requests(navigators: list[Navigator], told: list[list[RewardParams]]) -> NDArray[np.float64]:
    """Steering angle and speed of each car. Shape (n, 2)."""
    return np.array(
        [
            navigator.act(calls[-1]) if calls else navigator.first()
            for navigator, calls in zip(navigators, told, strict=True)
        ]
    )


def _recorder(calls: list[RewardParams]) -> RewardFunction:
    """A reward function that records its parameters, except for the waypoints."""

    def record(params: RewardParams) -> float:
        del params["waypoints"]
        calls.append(params)
        return 0.0

    return record

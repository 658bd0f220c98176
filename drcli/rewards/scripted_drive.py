"""Records reward parameters of scripted drivers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drcli.base.errors import SettingsError
from drcli.config.run_config import RaceConfig
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
from drcli.workers.build_race import car_parameters_of, load_race, load_world, race_of
from drsim.car.car import CONTROL_HZ
from drsim.car.car_parameters import CarParameters
from drsim.episode.episode_rules import EpisodeRules, Status
from drsim.episode.reward import RewardFunction, RewardParams
from drsim.episode.simulation import Simulation
from drsim.race.race import TIME_TRIAL, Race
from drsim.track.track import Track

_FORGIVEN = 1_000
_SLOWEST_LAP_MPS = 0.4


@dataclass(frozen=True)
class Trip:
    """One driver's episode; calls lack waypoints."""

    driver: ScriptedDriver
    calls: list[RewardParams]
    end: str
    progress: float

    @property
    def whole(self) -> bool:
        return self.progress >= 100.0

    @property
    def seconds(self) -> float:
        return len(self.calls) / CONTROL_HZ


@dataclass(frozen=True)
class Drive:
    """Of all drivers."""

    track: Track
    world: str
    race: Race
    race_type: str
    trips: list[Trip]

    def trip(self, driver: ScriptedDriver) -> Trip:
        return next(trip for trip in self.trips if trip.driver == driver)

    @property
    def start_fraction(self) -> float:
        """On the lap, 0 .. 1."""
        first = self.trip(STEADY).calls[0]
        travelled = first["progress"] / 100.0
        return float((first["projection_distance"] / self.track.length_m - travelled) % 1.0)

    def waypoints(self) -> dict[bool, list[tuple[float, float]]]:
        """By `is_reversed`."""
        return {track.reverse: track.waypoints for track in (self.track, self.track.reversed())}


def each_race(races: Sequence[RaceConfig]) -> list[RaceConfig]:
    """Distinct, the first worker's first."""
    distinct: dict[tuple[object, ...], RaceConfig] = {}
    for own in races:
        driving = (own.train_start_position_offset, own.train_alternate_driving_direction)
        race = (own.world_name, race_of(own), own.train_reverse_direction)
        distinct.setdefault((race, driving), own)
    return list(distinct.values())


def drive(config: RaceConfig) -> Drive:
    """Let all drivers drive.

    Raises:
        SettingsError: The track is missing, or the race does not fit.
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
        race,
        drivers,
        car_parameters_of(config),
        start=config.train_start_position_offset,
        reverse=config.train_reverse_direction,
    )
    driven = track.reversed() if config.train_reverse_direction else track
    return Drive(driven, config.world_name, race, config.race_type, trips)


def _trips(
    track: Track,
    race: Race,
    drivers: list[ScriptedDriver],
    parameters: CarParameters,
    *,
    start: float,
    reverse: bool,
) -> list[Trip]:
    if race.obstacles is not None:  # no obstacle may stop a driver for good
        race = replace(race, obstacles=replace(race.obstacles, mercy=1))
    backward = [reverse != driver.turned for driver in drivers]
    navigators = [
        Navigator(driver, track.reversed() if turned else track)
        for driver, turned in zip(drivers, backward, strict=True)
    ]
    calls: list[list[RewardParams]] = [[] for _ in drivers]
    max_steps = int(track.length_m / _SLOWEST_LAP_MPS * CONTROL_HZ)
    simulation = Simulation(
        track,
        num_cars=len(drivers),
        reward_function=[_recorder(own) for own in calls],
        rules=replace(EpisodeRules(), max_resets=_FORGIVEN, max_steps=max_steps),
        car_parameters=parameters,
        race=race,
    )
    starts = np.array([start + driver.start for driver in drivers])
    seeds = np.ones(len(drivers), np.uint64)  # the same objects for all drivers
    trips: dict[int, Trip] = {}
    try:
        simulation.reset(np.arange(len(drivers)), starts, reverse=np.array(backward), seeds=seeds)
        while len(trips) < len(drivers):
            requests = np.array(
                [
                    navigator.act(own[-1]) if own else navigator.first()
                    for navigator, own in zip(navigators, calls, strict=True)
                ]
            )
            result = simulation.step(requests[:, 0], requests[:, 1])
            for car, driver in enumerate(drivers):
                resets = int(result.resets[car])
                mishap = not driver.laps and resets > 0
                enough = len(calls[car]) >= driver.steps
                if car not in trips and (result.done[car] or mishap or enough):
                    end, progress = Status(result.status[car]).label, float(result.progress[car])
                    trips[car] = Trip(driver, calls[car].copy(), end, progress)
    finally:
        simulation.close()
    return [trips[car] for car in range(len(drivers))]


def _recorder(calls: list[RewardParams]) -> RewardFunction:
    def record(params: RewardParams) -> float:
        del params["waypoints"]
        calls.append(params)
        return 0.0

    return record

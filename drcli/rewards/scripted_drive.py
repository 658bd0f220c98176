"""Drives scripted drivers over the configured track and records what a reward function is told."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
    Pilot,
)
from drcli.workers.build_race import load_race, load_world, race_of
from drsim.car.car import CONTROL_HZ
from drsim.episode.episode import EpisodeRules, Status
from drsim.episode.reward import RewardFunction, RewardParams
from drsim.episode.simulation import Simulation
from drsim.race.race import TIME_TRIAL, Race
from drsim.track.track import Track

_FORGIVEN = 1_000
"""Mishaps after which a lap goes on: it has to be a whole one, whatever stands on the road."""

_SLOWEST_LAP_MPS = 0.4
"""A lap that takes longer than at this speed is given up."""


@dataclass(frozen=True)
class Trip:
    """One driver's episode.

    Attributes:
        pilot: Who drove.
        calls: What the reward function is told at each step, without the waypoints.
        end: How it ended, in the words of traces.
        progress: Percent of the lap, at its end.
        mishaps: How often the car was put back on the road.
    """

    pilot: Pilot
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
    """What every driver met.

    Attributes:
        track: The track as it is driven.
        world: Its name in the config.
        race: What else was on it.
        race_type: Its name in the config.
        trips: One for each driver.
    """

    track: Track
    world: str
    race: Race
    race_type: str
    trips: list[Trip]

    def trip(self, pilot: Pilot) -> Trip:
        """The trip of a driver that took part."""
        return next(trip for trip in self.trips if trip.pilot == pilot)

    @property
    def start_fraction(self) -> float:
        """Where on the lap the drivers of whole laps started, 0 .. 1."""
        first = self.trip(STEADY).calls[0]
        travelled = first["progress"] / 100.0
        return float((first["projection_distance"] / self.track.length_m - travelled) % 1.0)

    def waypoints(self) -> dict[bool, list[tuple[float, float]]]:
        """The parameter that is left out of `calls`, by `is_reversed`."""
        return {track.reverse: track.waypoints for track in (self.track, self.track.reversed())}


def each_race(races: Sequence[RaceConfig]) -> list[RaceConfig]:
    """The races of all workers, without those that differ in nothing that a driver meets."""
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
    if (why := config.why_not_trainable) is not None:
        raise SettingsError(
            why, remedy="Choose the race to train for, as in DR_RACE_TYPE=TIME_TRIAL dr-reward ..."
        )
    track = load_world(config)
    race = load_race(config, track)
    pilots = [STEADY, FAST, WEAVING, LEAVING, STANDING]
    if race != TIME_TRIAL:
        pilots.append(RAMMING)
    if config.train_alternate_driving_direction:
        pilots.append(TURNED)
    trips = _trips(
        track,
        _merciful(race),
        pilots,
        start=config.train_start_position_offset,
        reverse=config.train_reverse_direction,
    )
    driven = track.reversed() if config.train_reverse_direction else track
    return Drive(driven, config.world_name, race, config.race_type, trips)


def _merciful(race: Race) -> Race:
    """The race with rules under which nobody is held up by one obstacle for ever."""
    if race.obstacles is None:
        return race
    return replace(race, obstacles=replace(race.obstacles, mercy=1))


def _trips(
    track: Track, race: Race, pilots: list[Pilot], *, start: float, reverse: bool
) -> list[Trip]:
    directions = (track, track.reversed())
    backward = np.array([reverse != pilot.turned for pilot in pilots])
    drivers = [
        Navigator(pilot, directions[way])
        for pilot, way in zip(pilots, backward.tolist(), strict=True)
    ]
    told: list[list[RewardParams]] = [[] for _ in pilots]
    max_steps = int(track.length_m / _SLOWEST_LAP_MPS * CONTROL_HZ)
    simulation = Simulation(
        track,
        num_cars=len(pilots),
        reward_function=[_recorder(calls) for calls in told],
        rules=replace(EpisodeRules(), max_resets=_FORGIVEN, max_steps=max_steps),
        race=race,
    )
    cars = np.arange(len(pilots))
    starts = np.array([start + pilot.start for pilot in pilots])
    ends = ["in_progress"] * len(pilots)
    try:
        # All meet the same objects.
        simulation.reset(cars, starts, reverse=backward, seeds=np.ones(len(pilots), np.uint64))
        progress, resets = np.zeros(len(pilots)), np.zeros(len(pilots), np.int64)
        running = np.ones(len(pilots), np.bool_)
        while running.any():
            asked = _requests(drivers, told)
            known = [len(calls) for calls in told]
            result = simulation.step(asked[:, 0], asked[:, 1])
            for car, pilot in enumerate(pilots):
                if not running[car]:
                    del told[car][known[car] :]  # its trip was over before
                    continue
                progress[car], resets[car] = result.progress[car], result.resets[car]
                ends[car] = Status(result.status[car]).label
                mishap = not pilot.laps and resets[car] > 0
                enough = len(told[car]) >= pilot.steps
                running[car] = not (result.done[car] or mishap or enough)
    finally:
        simulation.close()
    return [
        Trip(*facts)
        for facts in zip(pilots, told, ends, progress.tolist(), resets.tolist(), strict=True)
    ]


def _requests(drivers: list[Navigator], told: list[list[RewardParams]]) -> NDArray[np.float64]:
    """Steering angle and speed of each car. Shape (n, 2)."""
    return np.array(
        [
            driver.act(calls[-1]) if calls else driver.first()
            for driver, calls in zip(drivers, told, strict=True)
        ]
    )


def _recorder(calls: list[RewardParams]) -> RewardFunction:
    """A reward function that keeps what it is told, but for the waypoints, always the same."""

    def record(params: RewardParams) -> float:
        del params["waypoints"]
        calls.append(params)
        return 0.0

    return record

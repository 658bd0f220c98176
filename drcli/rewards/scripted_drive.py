"""Records reward parameters of scripted drivers."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import ProblemsError
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.drive.build_race import actions_of, car_parameters_of, load_race, load_world
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.keys import MODEL_METADATA_FILE
from drcli.rewards.course import (
    FAST,
    LEAVING,
    RAMMING,
    STANDING,
    STEADY,
    TURNED,
    WEAVING,
    Call,
    ScriptedDriver,
    Trip,
    require_trainable,
    trip_of,
)
from drcli.rewards.source import own_file
from drsim.car.actions import Actions, ContinuousActions
from drsim.car.car import CONTROL_HZ, REAR_AXLE_BEHIND_M, WHEELBASE_M
from drsim.car.car_parameters import CarParameters
from drsim.episode.episode_rules import EpisodeRules, Status
from drsim.episode.reward import RewardFunction
from drsim.episode.simulation import Simulation
from drsim.race.race import TIME_TRIAL, Race
from drsim.sensing.scene import blank_scene
from drsim.track.track import Track

# Scripted drivers: steering and speed.


Floats = NDArray[np.float64]

_LOOK_AHEAD_M, _LOOK_AHEAD_S = 0.45, 0.18
_BRAKING_MPS2 = 2.0
_PROFILE_M = 0.1
_BEND_M = 0.5
_WEAVE_M = 4.0
_LEAVE_AFTER_M = 1.0

_SEES_M, _PASSED_M = 2.2, 0.5
_PASSING_MPS = 1.5
_FIRST_STEP_MPS = 1.0
_LIKE_DEG = 10.0
"""Steering that is as far off as a speed by 1 m/s."""


def read_actions(metadata: bytes | None) -> Actions | None:
    """Of a model's metadata; None without a usable file, whose faults other checks tell."""
    try:
        return None if metadata is None else actions_of(ModelMetadata.from_bytes(metadata))
    except ProblemsError:
        return None


def own_actions(settings: Settings) -> Actions | None:
    """Of the racer's model."""
    file = own_file(settings, MODEL_METADATA_FILE)
    return read_actions(None if file is None else file.data)


def nearest_action(actions: Actions, steering_deg: float, speed_mps: float) -> tuple[float, float]:
    """Degrees and m/s of the action that is most like a wish."""
    if isinstance(actions, ContinuousActions):
        (right, left), (slow, quick) = actions.steering_deg, actions.speed_mps
        return min(max(steering_deg, right), left), min(max(speed_mps, slow), quick)
    speeds_mps = [speed for _, speed in actions.choices]
    speed_mps = min(max(speed_mps, min(speeds_mps)), max(speeds_mps))

    def distance(action: tuple[float, float]) -> float:
        return math.hypot((action[0] - steering_deg) / _LIKE_DEG, action[1] - speed_mps)

    return min(actions.choices, key=distance)


def _greatest_speed_mps(actions: Actions) -> float:
    if isinstance(actions, ContinuousActions):
        return actions.speed_mps[1]
    return max(speed for _, speed in actions.choices)


class Navigator:
    """On a track in its driving direction."""

    def __init__(self, driver: ScriptedDriver, track: Track) -> None:
        self.driver = driver
        self._track = track
        self._speeds_mps = _speed_profile(track, driver)
        self._begun_m: float | None = None

    def first(self) -> tuple[float, float]:
        """Degrees and m/s of the first step, without parameters."""
        return 0.0, min(self.driver.speed_mps, _FIRST_STEP_MPS)

    def act(self, params: Call) -> tuple[float, float]:
        """Degrees and m/s, from the last step's parameters."""
        along_m = params["projection_distance"]
        if self._begun_m is None:
            self._begun_m = along_m
        side = self._blocked_side(params)
        last = len(self._speeds_mps) - 1
        speed_mps = float(self._speeds_mps[min(int(along_m / _PROFILE_M), last)])
        ahead_m = _LOOK_AHEAD_M + _LOOK_AHEAD_S * speed_mps
        if side:
            speed_mps, ahead_m = min(speed_mps, _PASSING_MPS), _LOOK_AHEAD_M
        x, y, yaw_rad = self._track.pose_at(np.array([along_m + ahead_m]))[0].tolist()
        aside_m = self._aside_m(params, along_m + ahead_m, side)
        x, y = x - aside_m * math.sin(yaw_rad), y + aside_m * math.cos(yaw_rad)
        return _steering_deg(params, x, y), speed_mps

    def _aside_m(self, params: Call, target_m: float, side: int) -> float:
        width_m = float(params["track_width"])
        manner = self.driver.manner
        if manner == "leave":
            gone_m = self._gap_m(params["projection_distance"], self._begun_m or 0.0)
            return (-side or 1) * 1.5 * width_m if gone_m > _LEAVE_AFTER_M else 0.0
        if side and manner == "ram":
            return side * width_m / 4
        if side:
            return -side * width_m / 3
        if manner == "weave":
            return 0.37 * width_m * math.sin(2 * math.pi * target_m / _WEAVE_M)
        return 0.0

    def _blocked_side(self, params: Call) -> int:
        """1 left, -1 right, 0 none."""
        gaps_m = [
            self._gap_m(there_m, params["projection_distance"])
            for there_m in params["objects_distance"]
        ]
        near = [k for k, gap_m in enumerate(gaps_m) if -_PASSED_M < gap_m < _SEES_M]
        if not near:
            return 0
        nearest = min(near, key=lambda k: abs(gaps_m[k]))
        return 1 if params["objects_left_of_center"][nearest] else -1

    def _gap_m(self, there_m: float, here_m: float) -> float:
        gap_m = there_m - here_m
        if not self._track.closed:
            return gap_m
        half_m = self._track.length_m / 2
        return (gap_m + half_m) % (2 * half_m) - half_m


def _steering_deg(params: Call, x: float, y: float) -> float:
    """To reach a point in an arc (pure pursuit)."""
    yaw_rad = math.radians(params["heading"])
    rear_x = params["x"] - REAR_AXLE_BEHIND_M * math.cos(yaw_rad)
    rear_y = params["y"] - REAR_AXLE_BEHIND_M * math.sin(yaw_rad)
    away_m = max(math.hypot(x - rear_x, y - rear_y), 0.1)
    turn_rad = math.atan2(y - rear_y, x - rear_x) - yaw_rad
    angle_deg = math.degrees(math.atan2(2 * WHEELBASE_M * math.sin(turn_rad), away_m))
    return max(-30.0, min(30.0, angle_deg))


def _speed_profile(track: Track, driver: ScriptedDriver) -> Floats:
    """Every 0.1 m."""
    along_m = np.arange(0.0, track.length_m + _PROFILE_M, _PROFILE_M)
    if driver.grip_mps2 is None:
        return np.full(len(along_m), driver.speed_mps)
    yaw_before, yaw_after = (
        track.pose_at(along_m + aside_m)[:, 2] for aside_m in (-_BEND_M / 2, _BEND_M / 2)
    )
    turn_rad = np.abs((yaw_after - yaw_before + np.pi) % (2 * np.pi) - np.pi)
    bend_mps = np.sqrt(driver.grip_mps2 * _BEND_M / np.maximum(turn_rad, 1e-6))
    speeds_mps = np.minimum(bend_mps, driver.speed_mps)
    rounds = 2 if track.closed else 1  # the braking before a bend may begin before the finish
    for k in range(rounds * len(speeds_mps) - 1, 0, -1):
        here, after = (k - 1) % len(speeds_mps), k % len(speeds_mps)
        reached = math.sqrt(speeds_mps[after] ** 2 + 2 * _BRAKING_MPS2 * _PROFILE_M)
        speeds_mps[here] = min(speeds_mps[here], reached)
    return speeds_mps


_FORGIVEN = 1_000
_SLOWEST_LAP_MPS = 0.4


@dataclass(frozen=True)
class Drive:
    """Of all drivers."""

    track: Track
    world: str
    race: Race
    race_type: str
    trips: list[Trip]

    def trip(self, driver: ScriptedDriver) -> Trip:
        return trip_of(self.trips, driver)

    @property
    def start_fraction(self) -> float:
        """On the lap, 0 .. 1."""
        first = self.trip(STEADY).calls[0]
        travelled = first["progress"] / 100.0
        return float((first["projection_distance"] / self.track.length_m - travelled) % 1.0)

    def waypoints(self) -> dict[bool, list[tuple[float, float]]]:
        """By `is_reversed`."""
        return {track.reverse: track.waypoints for track in (self.track, self.track.reversed())}


def drive(config: DriveConfig, actions: Actions | None = None) -> Drive:
    """Let all drivers drive; without `actions`, at any steering and speed.

    Raises:
        SettingsError: The track is missing, or the race does not fit.
    """
    require_trainable(config)
    track = load_world(config)
    race = load_race(config, track)
    fast = FAST
    if actions is not None:
        most_mps = _greatest_speed_mps(actions)
        about = f"follows the centre line at up to {most_mps:g} m/s"
        fast = replace(FAST, speed_mps=most_mps, about=about)
    drivers = [STEADY, fast, WEAVING, LEAVING, STANDING]
    if race != TIME_TRIAL:
        drivers.append(RAMMING)
    if config.train_alternate_driving_direction:
        drivers.append(TURNED)
    trips = _trips(
        track,
        race,
        drivers,
        car_parameters_of(config),
        actions,
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
    actions: Actions | None,
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
    calls: list[list[Call]] = [[] for _ in drivers]
    max_steps = int(track.length_m / _SLOWEST_LAP_MPS * CONTROL_HZ)
    simulation = Simulation(
        track,
        num_cars=len(drivers),
        reward_function=[_recorder(own) for own in calls],
        rules=replace(EpisodeRules(), max_resets=_FORGIVEN, max_steps=max_steps),
        num_threads=1,  # a second one costs more than it saves for so few cars
        scene=blank_scene(track),
        car_parameters=parameters,
        race=race,
    )
    simulation.draws = False
    starts = np.array([start + driver.start for driver in drivers])
    seeds = np.ones(len(drivers), np.uint64)  # the same objects for all drivers
    trips: dict[int, Trip] = {}
    try:
        simulation.reset(np.arange(len(drivers)), starts, reverse=np.array(backward), seeds=seeds)
        while len(trips) < len(drivers):
            wishes = [
                navigator.act(own[-1]) if own else navigator.first()
                for navigator, own in zip(navigators, calls, strict=True)
            ]
            if actions is not None:
                wishes = [nearest_action(actions, *wish) for wish in wishes]
            requests = np.array(wishes)
            result = simulation.step(requests[:, 0], requests[:, 1])
            for car, driver in enumerate(drivers):
                resets = int(result.resets[car])
                mishap = not driver.laps and resets > 0
                enough = len(calls[car]) >= driver.steps
                if car not in trips and (result.done[car] or mishap or enough):
                    end, progress = Status(result.status[car]).label, float(result.progress[car])
                    made = calls[car].copy()
                    trips[car] = Trip(driver, made, end, progress, len(made) / CONTROL_HZ)
    finally:
        simulation.close()
    return [trips[car] for car in range(len(drivers))]


def _recorder(calls: list[Call]) -> RewardFunction:
    def record(params: Call) -> float:
        del params["waypoints"]
        calls.append(params)
        return 0.0

    return record

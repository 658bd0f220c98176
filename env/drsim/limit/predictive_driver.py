"""Drives the MuJoCo car along a line as fast as it can, by looking ahead in copies of the car.

Copies try requests of half a second; the first step of the best is driven (the cross-entropy
method). `Simulation` then judges by the rules of episodes.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.car.car import CONTROL_HZ, CarBatch
from drsim.car.car_parameters import MAX_SPEED_MPS, MAX_STEERING_DEG, CarParameters
from drsim.episode.episode_rules import EpisodeRules, Status
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.limit.fastest_line import Line
from drsim.track.track import Track

_LEAST_MPS = 0.3
_FIRST_M = 1.0
"""The flying lap is measured from here."""
_FINER = 4
_KEPT_SHARE = 0.7
_PAST, _AHEAD = -8, 60
"""Points of the line in which a car is looked for."""
_OFFSET_S, _HEADING_S, _SLOW_S = 3.0, 0.15, 0.08
"""Costs of a plan's end: per square metre beside the line, per square radian, per m/s too slow."""
_OFF_S = 1.0
"""Per step without a wheel on the road."""


@dataclass(frozen=True)
class Effort:
    """How hard the driver looks: cars that try, rounds, and steps ahead."""

    copies: int = 48
    rounds: int = 2
    horizon: int = 10


class DrivenLap(NamedTuple):
    """What the car drove.

    Attributes:
        flying_s: Of the best lap; None if it left the road.
        standing_s: As an episode counts it; None if not clean.
    """

    flying_s: float | None
    standing_s: float | None


def drive_line(
    track: Track,
    line: Line,
    parameters: CarParameters,
    seed: int,
    effort: Effort | None = None,
) -> DrivenLap:
    """Drive a lap from rest and more, then judge it as an episode."""
    requests = _Planner(track, line, parameters, seed, effort or Effort()).requests()
    return _judged(track, parameters, requests)


def _judged(track: Track, parameters: CarParameters, requests: Floats) -> DrivenLap:
    simulation = Simulation(
        track,
        num_cars=1,
        reward_function=centre_line_reward,
        num_threads=1,
        car_parameters=parameters,
        rules=EpisodeRules.evaluation(laps=2),
    )
    car, standing_s = np.zeros(1, np.int64), None
    simulation.reset(car, np.zeros(1))
    places = [simulation.poses[0, :2]]
    for steering_deg, speed_mps in requests:
        step = simulation.step(np.array([steering_deg]), np.array([speed_mps]))
        places.append(simulation.poses[0, :2])
        if step.laps[0] and standing_s is None:
            standing_s = float(step.lap_time_s[0])
        if step.status[0] != Status.IN_PROGRESS:
            break
    simulation.close()
    clean = step.status[0] == Status.IN_PROGRESS and standing_s is not None
    if not clean:
        return DrivenLap(None, None)
    return DrivenLap(_flying_s(track, np.array(places)), standing_s)


def _flying_s(track: Track, places: Floats) -> float | None:
    length_m = track.length_m
    along_m = track.locate(places).distance_m
    moved_m = np.diff(along_m)
    moved_m -= length_m * np.round(moved_m / length_m)
    driven_m = np.concatenate([[0.0], np.cumsum(moved_m)])
    last_m = driven_m[-1] - length_m
    if last_m <= _FIRST_M:
        return None
    at_m = np.linspace(_FIRST_M, last_m, 5)
    steps = np.arange(len(driven_m))
    laps = np.interp(at_m + length_m, driven_m, steps) - np.interp(at_m, driven_m, steps)
    return float(laps.min()) / CONTROL_HZ


class _Planner:
    def __init__(
        self,
        track: Track,
        line: Line,
        parameters: CarParameters,
        seed: int,
        effort: Effort,
    ) -> None:
        self._track, self._effort = track, effort
        self._random = np.random.default_rng(seed)
        self._cars = CarBatch(effort.copies, 1, parameters)
        node, count = np.arange(len(line.xy) + 1), _FINER * len(line.xy)
        at = np.arange(count) / _FINER

        def finer(values: Floats) -> Floats:
            return np.asarray(np.interp(at, node, np.append(values, values[0])))

        ahead = np.roll(line.xy, -1, axis=0) - np.roll(line.xy, 1, axis=0)
        ahead /= np.hypot(*ahead.T)[:, None]
        self._x, self._y = finer(line.xy[:, 0]), finer(line.xy[:, 1])
        self._cos, self._sin = finer(ahead[:, 0]), finer(ahead[:, 1])
        self._yaw_rad = np.arctan2(self._sin, self._cos)
        self._speed = finer(line.speed_mps)
        self._lap_s = line.lap_s
        self._clock_s = np.interp(at, node, np.concatenate([[0.0], np.cumsum(line.step_s)]))

    def requests(self) -> Floats:
        effort, track, cars = self._effort, self._track, self._cars
        start = track.pose_at(np.zeros(1))
        cars.place(np.arange(effort.copies), np.repeat(start, effort.copies, axis=0))
        state = cars.state()
        here = self._nearest(start[0, :2])
        plan = np.column_stack([np.zeros(effort.horizon), np.full(effort.horizon, 3.0)])
        chosen: list[Floats] = []
        end_s = self._lap_s * (1.0 + 1.5 * _FIRST_M / track.length_m)
        driven_s = 0.0
        while driven_s < end_s and len(chosen) < 3 * self._lap_s * CONTROL_HZ:
            plan, state, there = self._improved(plan, state, here)
            driven_s += float(self._gained_s(here, there))
            here = there
            chosen.append(plan[0])
        return np.array(chosen)

    def _improved(self, plan: Floats, state: Floats, here: int) -> tuple[Floats, Floats, int]:
        effort = self._effort
        mean = np.vstack([plan[1:], plan[-1:]])
        spread = np.array([7.0, 0.5])
        best_cost, best = np.inf, (mean, state[0], here)
        for _ in range(effort.rounds):
            noise = self._random.standard_normal((effort.copies, effort.horizon, 2))
            for step in range(1, effort.horizon):
                fresh = np.sqrt(1.0 - _KEPT_SHARE**2) * noise[:, step]
                noise[:, step] = _KEPT_SHARE * noise[:, step - 1] + fresh
            scale = self._random.choice([0.3, 1.0, 1.5], (effort.copies, 1, 1))
            plans = mean + noise * spread * scale
            plans[0], plans[1] = mean, best[0]
            plans[..., 0] = plans[..., 0].clip(-MAX_STEERING_DEG, MAX_STEERING_DEG)
            plans[..., 1] = plans[..., 1].clip(_LEAST_MPS, MAX_SPEED_MPS)
            cost, after, points = self._tried(plans, state, here)
            order = cost.argsort()
            if cost[order[0]] < best_cost:
                first = order[0]
                best_cost, best = cost[first], (plans[first], after[first], int(points[first]))
            mean, spread = plans[order[:6]].mean(axis=0), spread * 0.6
        chosen, after_it, point = best
        return chosen, np.repeat(after_it[None], effort.copies, axis=0), point

    def _tried(self, plans: Floats, state: Floats, here: int) -> tuple[Floats, Floats, Ints]:
        cars = self._cars
        cars.set_state(state)
        point: Ints = np.full(len(plans), here)
        on_road: Bools = np.ones(len(plans), np.bool_)
        off_steps = np.zeros(len(plans))
        first_state, first_point = state, point
        for step in range(plans.shape[1]):
            cars.drive(plans[:, step, 0], plans[:, step, 1])
            point = self._followed(point)
            if step == 0:
                first_state, first_point = cars.state(), point
            on_road &= self._track.on_road(cars.wheel_xy).any(axis=1)
            off_steps += ~on_road
        dx, dy = cars.origin_xy[:, 0] - self._x[point], cars.origin_xy[:, 1] - self._y[point]
        cos, sin = self._cos[point], self._sin[point]
        beside_m, ahead_m = cos * dy - sin * dx, cos * dx + sin * dy
        turned = np.angle(np.exp(1j * (cars.yaw_rad - self._yaw_rad[point])))
        speed = self._speed[point]
        slow, fast = np.maximum(speed - cars.speed, 0.0), np.maximum(cars.speed - speed, 0.0)
        gained_s = self._gained_s(here, point) + ahead_m / speed
        cost = _OFFSET_S * beside_m**2 + _HEADING_S * turned**2
        cost += _SLOW_S * (slow + 2.0 * fast**2) + _OFF_S * off_steps - gained_s
        return cost, first_state, first_point

    def _followed(self, point: Ints) -> Ints:
        near = (point[:, None] + np.arange(_PAST, _AHEAD)) % len(self._x)
        xy = self._cars.origin_xy
        away = (xy[:, :1] - self._x[near]) ** 2 + (xy[:, 1:] - self._y[near]) ** 2
        return np.take_along_axis(near, away.argmin(axis=1)[:, None], axis=1)[:, 0]

    def _nearest(self, xy: Floats) -> int:
        return int(((self._x - xy[0]) ** 2 + (self._y - xy[1]) ** 2).argmin())

    def _gained_s(self, here: int, there: Ints | int) -> Floats:
        gained_s = self._clock_s[there] - self._clock_s[here]
        return np.asarray((gained_s + self._lap_s / 2) % self._lap_s - self._lap_s / 2)

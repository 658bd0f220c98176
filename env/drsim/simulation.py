"""Many cars on one track: motion, camera, reward and episodes, all cars in one array pass."""

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from drsim.car import CONTROL_HZ, CarBatch, CarParameters
from drsim.episode import EpisodeRules, Episodes, Status
from drsim.frames import FrameRenderer
from drsim.params import Situation, params_of
from drsim.progress import JUMP_M, fraction_at, without_jump
from drsim.reward import REWARD_DEADLINE_S, RewardFunction, checked_rewards
from drsim.scene import Scene, build_scene
from drsim.step import StepResult
from drsim.track import Lane, Location, Track

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_WHEELS = 4


class Simulation:
    """Cars that drive episodes on one track without knowing of each other.

    The same actions give bit-identical observations and rewards on one machine, whatever the
    number of threads. A car is parked until `reset` and again when its episode is over.

    Attributes:
        track: The track in the direction given.
        observations: Current camera frame of each car, grey. A live view. Shape (n, 120, 160).
    """

    def __init__(
        self,
        track: Track,
        *,
        num_cars: int,
        reward_function: RewardFunction,
        rules: EpisodeRules | None = None,
        num_threads: int = 2,
        seed: int = 0,
        scene: Scene | None = None,
        car_parameters: CarParameters | None = None,
        reward_deadline_s: float = REWARD_DEADLINE_S,
    ) -> None:
        """Build the cars and, unless given, the picture of the track.

        Args:
            track: Where they drive.
            num_cars: How many, at least 1.
            reward_function: Called once for every driven step of every car.
            rules: When episodes end; those of training when left out.
            num_threads: Threads for physics and camera, the caller's included.
            seed: Seed of everything random; nothing is random as long as the world is not
                randomised, so today it changes nothing.
            scene: What the cameras see; built from the track when left out.
            car_parameters: The cars; the calibrated ones when left out.
            reward_deadline_s: How long one call of the reward function may take, seconds.
        """
        self.track = track
        self.num_cars = num_cars
        self.rules = rules or EpisodeRules()
        self.seed = seed
        self._tracks = (track, track.reversed())
        self._backward: Ints = np.zeros(num_cars, np.int64)
        self._renderer = FrameRenderer(scene or build_scene(track), num_cars, num_threads)
        self.observations = self._renderer.frames
        self._cars = CarBatch(num_cars, num_threads, car_parameters)
        self._episodes = Episodes(num_cars, self.rules)
        self._along_m: Floats = np.zeros(num_cars)
        self._ticks: Ints = np.zeros(num_cars, np.int64)
        self._reward_function = reward_function
        self._reward_deadline_s = reward_deadline_s

    def reset(
        self, cars: Ints, start_fraction: Floats, *, reverse: bool | Bools = False
    ) -> StepResult:
        """Begin episodes: put cars on the centre line at rest and take the `prepare` step.

        Args:
            cars: Which cars, running or not. Shape (k,).
            start_fraction: Where on the lap each begins, 0 .. 1. Shape (k,).
            reverse: Drive the lap against the direction of `track`. One value or shape (k,).

        Returns:
            The first row of the episodes: status PREPARE, steps 1, reward 0.
        """
        cars = np.asarray(cars, np.int64)
        start_fraction = np.asarray(start_fraction, np.float64)
        if self.track.closed:
            start_fraction = start_fraction % 1.0
        self._backward[cars] = np.asarray(reverse, np.int64)
        self._cars.place(cars, self._poses(cars, start_fraction, "center"))
        self._start_rendering(np.sort(cars))
        self._ticks[cars] += 1
        where = self._locate()
        self._along_m[cars] = where.distance_m[cars]
        self._episodes.begin(cars, start_fraction, self._along_m[cars] / self.track.length_m)

        nobody = np.zeros(self.num_cars, np.bool_)
        nothing = np.zeros(self.num_cars)
        status = np.where(self._episodes.over, Status.PARK, Status.IN_PROGRESS)
        status[self._episodes.pause_steps > 0] = Status.PAUSE
        status[cars] = Status.PREPARE
        situation = self._situation(where, self._wheels_on(), nothing, nothing)
        result = self._result(situation, nobody, nothing, nobody, nobody, status)
        self._renderer.finish()
        return result

    def step(self, steering_deg: Floats, speed_mps: Floats) -> StepResult:
        """Let all running cars act for 1/15 s; parked and waiting cars ignore their action.

        Args:
            steering_deg: Wheel angles asked for, left positive. Shape (n,).
            speed_mps: Speeds asked for. Shape (n,).

        Returns:
            What became of it.

        Raises:
            RewardError: The reward function failed.
        """
        episodes = self._episodes
        running = ~episodes.over
        driven = running & (episodes.pause_steps == 0)
        waiting = running & ~driven
        came_from = self._cars.origin_xy.copy()
        self._cars.drive(steering_deg, speed_mps, driven)
        self._start_rendering(np.flatnonzero(driven))
        try:
            self._ticks[running] += 1
            where = self._locate()
            self._follow(where)
            moved_m = np.hypot(*(self._cars.origin_xy - came_from).T)
            wheels_on = self._wheels_on()
            fraction = self._along_m / self.track.length_m
            verdict = episodes.judge(driven, fraction, moved_m, wheels_on == 0)
            episodes.wait(waiting)

            situation = self._situation(where, wheels_on, steering_deg, speed_mps)
            rewards = self._rewards(situation, driven)
        finally:
            self._renderer.finish()
        status = np.where(waiting, Status.PAUSE, np.where(driven, verdict.status, Status.PARK))
        result = self._result(
            situation, driven, rewards, verdict.terminated, verdict.truncated, status
        )
        if verdict.put_back.any():
            self._put_back(np.flatnonzero(verdict.put_back), came_from)
        return result

    def close(self) -> None:
        """Stop the threads that render."""
        self._renderer.close()

    def _put_back(self, cars: Ints, came_from: Floats) -> None:
        """Place cars where they were before their violation, on the lane nearer to them."""
        episodes = self._episodes
        fraction = fraction_at(episodes.previous_progress[cars], episodes.start_fraction[cars])
        inner = self._poses(cars, fraction, "inner")
        outer = self._poses(cars, fraction, "outer")
        to_inner_m = np.hypot(*(inner[:, :2] - came_from[cars]).T)
        to_outer_m = np.hypot(*(outer[:, :2] - came_from[cars]).T)
        self._cars.place(cars, np.where((to_inner_m <= to_outer_m)[:, None], inner, outer))
        self._along_m[cars] = self._locate().distance_m[cars]
        episodes.put_back(cars, self._along_m[cars] / self.track.length_m)
        self._start_rendering(cars)
        self._renderer.finish()

    def _start_rendering(self, cars: Ints) -> None:
        self._renderer.start(cars, self._cars.lens_pos, self._cars.lens_mat)

    def _poses(self, cars: Ints, fraction: Floats, lane: Lane) -> Floats:
        """Poses on a lane, each in the driving direction of its car. Shape (k, 3)."""
        poses = np.empty((len(cars), 3))
        for direction, track in enumerate(self._tracks):
            chosen = self._backward[cars] == direction
            if chosen.any():
                poses[chosen] = track.pose_at(fraction[chosen] * track.length_m, lane)
        return poses

    def _locate(self) -> Location:
        points = self._cars.front_xy
        where = self._tracks[0].locate(points)
        if self._backward.any():
            mirrored = self._tracks[1].locate(points)
            flags = self._backward.astype(np.bool_)
            for field in fields(Location):
                getattr(where, field.name)[flags] = getattr(mirrored, field.name)[flags]
        return where

    def _wheels_on(self) -> Ints:
        """How many wheels of each car are on the track. Shape (n,)."""
        on_road: Ints = self.track.on_road(self._cars.wheel_xy).sum(axis=1)
        return on_road

    def _follow(self, where: Location) -> None:
        """Keep how far along the line each car is, without jumps to neighbouring stretches."""
        suspects = np.flatnonzero(np.abs(where.distance_m - self._along_m) > JUMP_M)
        along_m = where.distance_m.copy()
        for car in suspects:
            track = self._tracks[self._backward[car]]
            along_m[car] = without_jump(
                track, self._cars.front_xy[car], along_m[car], self._along_m[car]
            )
        self._along_m = along_m

    def _situation(
        self,
        where: Location,
        wheels_on: Ints,
        steering_deg: Floats,
        speed_mps: Floats,
    ) -> Situation:
        return Situation(
            xy=self._cars.front_xy.copy(),
            heading_deg=np.degrees(self._cars.yaw_rad),
            where=where,
            all_on=wheels_on == _WHEELS,
            none_on=wheels_on == 0,
            progress=self._episodes.progress.copy(),
            steps=self._episodes.steps.copy(),
            sim_time_s=self._ticks / CONTROL_HZ,
            steering_deg=np.asarray(steering_deg, np.float64),
            speed_mps=np.asarray(speed_mps, np.float64),
            backward=self._backward,
        )

    def _rewards(self, situation: Situation, driven: Bools) -> Floats:
        cars = np.flatnonzero(driven)
        rewards = np.zeros(self.num_cars)
        calls = params_of(self._tracks, situation, cars)
        rewards[cars] = checked_rewards(self._reward_function, calls, self._reward_deadline_s)
        return rewards

    def _result(
        self,
        situation: Situation,
        driven: Bools,
        reward: Floats,
        terminated: Bools,
        truncated: Bools,
        status: Ints,
    ) -> StepResult:
        episodes = self._episodes
        return StepResult(
            driven=driven,
            reward=reward,
            terminated=terminated,
            truncated=truncated,
            status=status,
            progress=situation.progress,
            x=situation.xy[:, 0],
            y=situation.xy[:, 1],
            yaw_deg=situation.heading_deg,
            all_wheels_on_track=situation.all_on,
            closest_waypoint=situation.where.nearest,
            from_center_m=situation.where.from_center_m,
            steps=situation.steps,
            sim_time_s=situation.sim_time_s,
            pause_s=episodes.pause_steps / CONTROL_HZ,
            laps=episodes.laps.copy(),
            lap_time_s=episodes.lap_steps / CONTROL_HZ,
            resets=episodes.resets.copy(),
        )

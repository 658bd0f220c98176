"""Many cars on one track: motion, observations, rewards and episodes."""

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from drsim.arrays import Bools, Bytes, Floats, Ints, Seeds, Singles
from drsim.car.car import CONTROL_HZ, WHEELS_M, CarBatch
from drsim.car.car_parameters import CarParameters
from drsim.car.conditions import Conditions, Realism
from drsim.car.physics import PhysicsChoice
from drsim.episode.episode_draws import EpisodeDraws
from drsim.episode.episode_rules import EpisodeRules, Episodes, Observed, Status, StepResult
from drsim.episode.params import Situation, params_of
from drsim.episode.placing import CarPlacement, Placing, TrackPositions, mark_unstable
from drsim.episode.reward import REWARD_DEADLINE_S, RewardFunction, RewardHost, checked_rewards
from drsim.episode.teacher_features import (
    CRITIC_PLACE,
    TEACHER_PLACE,
    CarsNow,
    features,
    teacher_features,
)
from drsim.errors import RewardError
from drsim.race.race import TIME_TRIAL, Race
from drsim.race.traffic import Traffic
from drsim.sensing.observations import Observations, Randomize
from drsim.sensing.scene import Scene
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track
from drsim.track.ways import Ways

# Calls the reward functions of many cars.


class RewardCalls:
    """Rewards by the reward function of each car."""

    def __init__(
        self,
        functions: Sequence[RewardFunction] | RewardHost,
        deadline_s: float,
        on_error: Callable[[RewardError, int], float] | None,
        clock: Callable[[], float],
    ) -> None:
        self.made = 0
        self._functions = functions
        self._deadline_s = deadline_s
        self._on_error = on_error
        self._clock = clock

    def rewards(
        self, tracks: Sequence[Track], situation: Situation, driven: Bools
    ) -> tuple[Floats, Floats, Bools, Bools]:
        """Rewards, seconds of the calls, which failed, whose episodes are declared broken.

        Raises:
            RewardError: A function failed, and nobody takes its failure.
        """
        cars = np.flatnonzero(driven)
        rewards, seconds = np.zeros(len(driven)), np.zeros(len(driven))
        failed, discarded = np.zeros(len(driven), np.bool_), np.zeros(len(driven), np.bool_)

        def instead(call: int, error: RewardError) -> float:
            made = begun + call + 1
            if error.kind == "discard":
                discarded[cars[call]] = True
                if self._on_error is not None:
                    self._on_error(error, made)
                return 0.0
            if self._on_error is None:
                raise error from error.__cause__
            failed[cars[call]] = True
            return self._on_error(error, made)

        begun = self.made
        self.made += len(cars)
        calls = params_of(tracks, situation, cars)
        if isinstance(self._functions, RewardHost):
            found = self._functions.rewards(cars.tolist(), calls, self._deadline_s, instead)
        else:
            own = [self._functions[car] for car in cars.tolist()]
            found = checked_rewards(own, calls, self._deadline_s, instead, self._clock)
        rewards[cars], seconds[cars] = found
        return rewards, seconds, failed, discarded

    def close(self) -> None:
        if isinstance(self._functions, RewardHost):
            self._functions.close()


class Simulation:
    """Cars that drive episodes on one track, each with a track to itself unless they race.

    The same actions give bit-identical results on one machine, unless MuJoCo Warp moves the cars.
    A car is parked until `reset` and after its episode.

    Attributes:
        track: In the direction given.
        color: Whether frames are red, green and blue.
        frames: Grey, or red, green and blue. A live view. Shape (n, eyes or 3, 120, 160).
        scans: Of the lidar sensor. Shape (n, d), d may be 0.
        traffic: None where a car is alone.
        physics: What moves the cars and why, for a log.
        draws: Whether frames and scans are refreshed; several times as fast without.
        unstable: Cars whose physics failed in the last step: put back, and off track. Shape (n,).
    """

    def __init__(
        self,
        track: Track | Sequence[Track],
        *,
        num_cars: int,
        reward_function: RewardFunction | Sequence[RewardFunction] | RewardHost,
        rules: EpisodeRules | None = None,
        num_threads: int = 2,
        seed: int = 0,
        scene: Scene | None = None,
        car_parameters: CarParameters | None = None,
        reward_deadline_s: float = REWARD_DEADLINE_S,
        on_reward_error: Callable[[RewardError, int], float] | None = None,
        race: Race = TIME_TRIAL,
        sensors: Sensors | None = None,
        realism: Realism | None = None,
        randomize: Randomize = "nothing",
        longest_latency_s: float = 0.0,
        reward_clock: Callable[[], float] = perf_counter,
        color: bool = False,
        gpu: bool = False,
        physics: PhysicsChoice = "mujoco",
    ) -> None:
        """Build the cars and, unless given, the picture of the track.

        Args:
            track: Where they drive; of several, `reset` chooses.
            num_cars: A multiple of `race.racers`.
            reward_function: Called once per driven step and car; one for each car where it keeps
                something between steps, or a host that calls them.
            rules: Default: those of training.
            num_threads: For physics and camera, the caller's included.
            seed: Of episodes without one of their own.
            scene: Of the one track; default: built.
            car_parameters: Default: the calibrated ones.
            reward_deadline_s: Of one call, seconds.
            on_reward_error: From a failure and the number of calls to the reward instead, or it
                raises. Also told of `discard`, without effect.
            race: What else is on the track.
            sensors: Default: the front camera.
            realism: Sim-to-real extras; default: none.
            randomize: Lights and colours that change from episode to episode.
            longest_latency_s: Of conditions for `reset`, if longer than what `realism` draws.
            reward_clock: In seconds.
            color: Frames of one eye are red, green and blue; three times the work.
            gpu: Draw the frames on an NVIDIA GPU.
            physics: Where MuJoCo Warp cannot run, MuJoCo does.

        Raises:
            ValueError: The race does not fit on the track, or the number of cars not the race.
            OSError: There is no GPU that can be used.
        """
        if num_cars % race.racers:
            raise ValueError(f"{num_cars} cars cannot race in groups of {race.racers}.")
        self.tracks = (track,) if isinstance(track, Track) else tuple(track)
        self.track = self.tracks[0]
        self.num_cars = num_cars
        self.rules = rules or EpisodeRules()
        self._ways = Ways(self.tracks, num_cars)
        self._race = race
        self.traffic = None if race == TIME_TRIAL else Traffic(self._ways, race)
        realism = realism or Realism()
        self._draws = EpisodeDraws(
            num_cars,
            seed,
            race.racers,
            realism,
            traffic=self.traffic is not None,
            randomizes=randomize != "nothing",
        )
        self._observations = Observations(
            None if scene is None else [scene],
            num_threads,
            ways=self._ways,
            sensors=sensors or Sensors(),
            traffic=self.traffic,
            disturbances=self._draws.disturbances,
            randomize=randomize,
            color=color,
            gpu=gpu,
        )
        self.color = color
        self.draws = True
        self.frames = self._observations.frames
        self.scans = self._observations.scans
        self._cars = CarBatch(
            num_cars,
            num_threads,
            car_parameters,
            longest_latency_s=max(realism.longest_latency_s, longest_latency_s),
            physics=physics,
        )
        self.physics = self._cars.physics
        self._placement = CarPlacement(Placing(self._ways), self._cars, self.traffic)
        self._episodes = Episodes(num_cars, self.rules)
        self.unstable: Bools = np.zeros(num_cars, np.bool_)
        self._positions = TrackPositions(self._ways, self._cars)
        self._ticks: Ints = np.zeros(num_cars, np.int64)
        self._requests: Floats = np.zeros((num_cars, 2))
        self._rewards = RewardCalls(
            [reward_function] * num_cars if callable(reward_function) else reward_function,
            reward_deadline_s,
            on_reward_error,
            reward_clock,
        )

    def reset(
        self,
        cars: Ints,
        start_fraction: Floats,
        *,
        track: int | Ints = 0,
        reverse: bool | Bools = False,
        seeds: Seeds | None = None,
        offset_m: Floats | None = None,
        angle_deg: Floats | None = None,
        conditions: Conditions | Sequence[Conditions] | None = None,
    ) -> StepResult:
        """Begin episodes: put cars on the track at rest, for the `prepare` step.

        Cars start on the centre line, or on the lane away from an obstacle; racers side by side,
        each second one a little further back.

        Args:
            cars: Running or not. Shape (k,).
            start_fraction: Of the lap, 0 .. 1. Shape (k,).
            track: Which of the tracks. One value or shape (k,).
            reverse: Against the direction of that track. One value or shape (k,).
            seeds: Default: from the simulation's seed, the car and the count of its episodes.
                Shape (k,).
            offset_m: To the left of the centre line; less where wheels would leave the road, or 0
                on another lane. Shape (k,).
            angle_deg: To the left of the driving direction. Shape (k,).
            conditions: Instead of what `realism` draws: one for all, or k. Not about traffic, nor
                what `randomize` draws.

        Returns:
            The first row of the episodes: status PREPARE, steps 1, reward 0.

        Raises:
            ValueError: There are not k conditions, or their latency is longer than the cars were
                built for.
        """
        cars = np.asarray(cars, np.int64)
        start_fraction = np.asarray(start_fraction, np.float64)
        self._ways.choose(cars, track, reverse)
        closed = self._ways.closed[cars]
        start_fraction = np.where(closed, start_fraction % 1.0, start_fraction)
        self._requests[cars] = 0.0
        seeds = self._draws.seeds(cars) if seeds is None else np.asarray(seeds, np.uint64)
        self._draws.begin(cars, seeds, conditions, self._observations, self._cars)
        self._placement.start(cars, start_fraction, seeds, offset_m, angle_deg)
        self._start_to_draw(np.sort(cars))
        self._ticks[cars] += 1
        self._positions.refresh_placed(cars)
        self._episodes.begin(
            cars, start_fraction, self._positions.along_m[cars] / self._ways.length_m[cars]
        )

        nobody = np.zeros(self.num_cars, np.bool_)
        nothing = np.zeros(self.num_cars)
        status = np.where(self._episodes.state.over, Status.PARK, Status.IN_PROGRESS)
        status[self._episodes.state.pause_steps > 0] = Status.PAUSE
        status[cars] = Status.PREPARE
        result = self._result(nobody, nothing, nobody, nothing, nobody, nobody, status)
        self._observations.finish()
        return result

    def step(self, steering_deg: Floats, speed_mps: Floats) -> StepResult:
        """Let all running cars act for 1/15 s; parked and waiting cars ignore their action.

        Angles are left positive. Shape (n,) each. An episode declared broken ends with the status
        `DISCARDED` and the reward 0.

        Raises:
            RewardError: The reward function failed.
        """
        episodes = self._episodes
        running = ~episodes.state.over
        driven = running & (episodes.state.pause_steps == 0)
        waiting = running & ~driven
        came_from, came_yaw = self._cars.origin_xy.copy(), self._cars.yaw_rad.copy()
        self._cars.drive(steering_deg, speed_mps, driven)
        self._requests[driven] = np.column_stack([steering_deg, speed_mps])[driven]
        cars = self._cars
        if mark_unstable(cars.origin_xy, came_from, cars.yaw_rad, cars.lens_pos, self.unstable):
            poses = np.column_stack([came_from, came_yaw])[self.unstable]
            cars.place(np.flatnonzero(self.unstable), poses)
        if self.traffic is not None:
            self.traffic.advance(running)
            self.traffic.follow(self._cars.origin_xy, self._cars.yaw_rad)
        # A car that waits sees the traffic go on.
        self._start_to_draw(np.flatnonzero(driven if self.traffic is None else running))
        try:
            self._ticks[running] += 1
            self._positions.refresh()
            moved_m = np.hypot(*(self._cars.origin_xy - came_from).T)
            contacts = None
            if self.traffic is not None:
                contacts = self.traffic.contacts(
                    driven, self._cars.origin_xy, self._cars.yaw_rad, self._positions.along_m
                )
            crashed = contacts.crashed if contacts is not None else np.zeros_like(driven)
            fraction = self._positions.along_m / self._ways.length_m
            off_track = (self._positions.wheels_on == 0) | self.unstable
            verdict = episodes.judge(Observed(driven, fraction, moved_m, off_track, crashed))
            episodes.wait(waiting)
            situation = self._situation(
                steering_deg, speed_mps, driven & (verdict.status == Status.CRASHED)
            )
            rewards, reward_time_s, failed, discarded = self._rewards.rewards(
                self._ways.tracks, situation, driven
            )
            if discarded.any():
                episodes.discard(discarded, verdict)
        finally:
            self._observations.finish()
        status = np.where(waiting, Status.PAUSE, np.where(driven, verdict.status, Status.PARK))
        result = self._result(
            driven, rewards, failed, reward_time_s, verdict.terminated, verdict.truncated, status
        )
        if verdict.put_back.any():
            forgiven = np.flatnonzero(verdict.put_back)
            self._placement.put_back(forgiven, episodes.state, verdict.status, came_from, contacts)
            self._requests[forgiven] = 0.0
            self._positions.refresh_placed(forgiven)
            along = self._positions.along_m[forgiven] / self._ways.length_m[forgiven]
            episodes.put_back(forgiven, along)
            self._start_to_draw(forgiven)
            self._observations.finish()
        if self._race.racers > 1 and result.done.any():
            done = np.flatnonzero(result.done)
            self._placement.move_aside(done, fraction[done])
        return result

    @property
    def reward_calls(self) -> int:
        return self._rewards.made

    @property
    def observations(self) -> Bytes:
        """Frames of the first eye. A live view. Shape (n, 120, 160)."""
        return self.frames[:, 0]

    @property
    def device_frames(self) -> Any:
        """`frames` on the GPU, with the interface of CUDA arrays; None without one."""
        return self._observations.device_frames

    @property
    def poses(self) -> Floats:
        """Origins in metres and yaws in radians. Shape (n, 3)."""
        return np.column_stack([self._cars.origin_xy, self._cars.yaw_rad])

    @property
    def wheels(self) -> Floats:
        """As `CarBatch.wheels`."""
        return self._cars.wheels

    @property
    def speeds_mps(self) -> Floats:
        return self._cars.speed.copy()

    def privileged(self, cars: Ints) -> Singles:
        """See `features`; 0 for the place on the lap where there are several tracks."""
        here = np.column_stack([self._cars.front_xy[cars], self._cars.yaw_rad[cars]])
        rows = features(
            self._ways.tracks,
            cars,
            self._ways.way[cars],
            here,
            self._cars.speed[cars],
            self._positions.along_m[cars],
            self.traffic,
        )
        if len(self.tracks) > 1:
            rows[:, CRITIC_PLACE] = 0.0
        return rows

    def teacher_state(self, cars: Ints) -> Singles:
        """See `teacher_features`; 0 for the place on the lap where there are several tracks."""
        state = self._episodes.state
        now = CarsNow(
            cars=cars,
            way=self._ways.way[cars],
            poses=np.column_stack([self._cars.front_xy[cars], self._cars.yaw_rad[cars]]),
            velocity=self._cars.velocity[cars],
            wheel_rad=self._cars.wheels[cars, 0],
            requests=self._requests[cars],
            along_m=self._positions.along_m[cars],
            track_width_m=self._positions.where.track_width_m[cars],
            progress=state.progress[cars],
            steps=state.steps[cars],
        )
        rows = teacher_features(self._ways.tracks, now, self.traffic, self._cars.speed)
        if len(self.tracks) > 1:
            rows[:, TEACHER_PLACE] = 0.0
        return rows

    def close(self) -> None:
        """Stop threads, and the host of reward functions."""
        self._observations.close()
        self._rewards.close()

    def _start_to_draw(self, cars: Ints) -> None:
        if self.draws:
            self._observations.look(cars, self._cars)

    def _situation(self, steering_deg: Floats, speed_mps: Floats, crashed: Bools) -> Situation:
        return Situation(
            xy=self._cars.front_xy,
            heading_deg=np.degrees(self._cars.yaw_rad),
            where=self._positions.where,
            all_on=self._positions.wheels_on == len(WHEELS_M),
            none_on=self._positions.wheels_on == 0,
            progress=self._episodes.state.progress,
            steps=self._episodes.state.steps,
            sim_time_s=self._ticks / CONTROL_HZ,
            steering_deg=np.asarray(steering_deg, np.float64),
            speed_mps=np.asarray(speed_mps, np.float64),
            way=self._ways.way,
            crashed=crashed,
            objects=None if self.traffic is None else self.traffic.objects(),
        )

    def _result(
        self,
        driven: Bools,
        reward: Floats,
        failed: Bools,
        reward_time_s: Floats,
        terminated: Bools,
        truncated: Bools,
        status: Ints,
    ) -> StepResult:
        state, where = self._episodes.state, self._positions.where
        x, y = self._cars.front_xy.T.copy()
        return StepResult(
            driven=driven,
            reward=reward,
            failed=failed,
            reward_time_s=reward_time_s,
            terminated=terminated,
            truncated=truncated,
            status=status,
            progress=state.progress.copy(),
            x=x,
            y=y,
            yaw_deg=np.degrees(self._cars.yaw_rad),
            all_wheels_on_track=self._positions.wheels_on == len(WHEELS_M),
            closest_waypoint=where.nearest,
            from_center_m=where.from_center_m,
            steps=state.steps.copy(),
            sim_time_s=self._ticks / CONTROL_HZ,
            pause_s=state.pause_steps / CONTROL_HZ,
            laps=state.laps.copy(),
            lap_time_s=state.lap_steps / CONTROL_HZ,
            resets=state.resets.copy(),
            crashes=state.crashes.copy(),
        )

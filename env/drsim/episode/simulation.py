"""Many cars on one track: motion, observations, rewards and episodes, all cars at once."""

from collections.abc import Callable, Sequence

import numpy as np

from drsim.arrays import Bools, Bytes, Floats, Ints, Seeds, Singles
from drsim.car.car import CONTROL_HZ, WHEELS_M, CarBatch, CarParameters
from drsim.car.conditions import Conditions
from drsim.car.disturbances import Disturbances
from drsim.car.realism import Realism
from drsim.episode.episode_rules import EpisodeRules, Episodes, Observed, Status
from drsim.episode.params import Situation, params_of
from drsim.episode.placing import JUMP_M, Placing, fraction_at, without_jump
from drsim.episode.privileged_features import features
from drsim.episode.reward import REWARD_DEADLINE_S, RewardFunction, checked_rewards
from drsim.episode.stability import mark_unstable
from drsim.episode.start_poses import start_pose
from drsim.episode.step import StepResult
from drsim.errors import RewardError
from drsim.race.race import TIME_TRIAL, Race
from drsim.race.traffic import Contacts, Traffic
from drsim.sensing.observations import Observations, Randomize
from drsim.sensing.scene import Scene, build_scene
from drsim.sensing.sensors import Sensors
from drsim.track.polyline import Location
from drsim.track.track import CENTER, Track


class Simulation:
    """Cars that drive episodes on one track, each with a track to itself unless they race.

    The same actions give bit-identical observations and rewards on one machine, whatever the
    number of threads. A car is parked until `reset` and again when its episode is over.

    Attributes:
        track: The track in the direction given.
        frames: Current camera frames of each car, grey. A live view. Shape (n, eyes, 120, 160).
        scans: Current values of the lidar sensor; of width 0 without one. Shape (n, d).
        traffic: The obstacles, bots and opponents of each car; None where a car is alone.
        unstable: Cars whose physics failed in the last step: they jumped, flew or became NaN. They
            stand where they were before that step, and count as off track. Shape (n,).
        reward_calls: How often reward functions were called so far, by all cars together.
    """

    def __init__(
        self,
        track: Track,
        *,
        num_cars: int,
        reward_function: RewardFunction | Sequence[RewardFunction],
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
    ) -> None:
        """Build the cars and, unless given, the picture of the track.

        Args:
            track: Where they drive.
            num_cars: How many, at least 1; a multiple of `race.racers`.
            reward_function: Called once for every driven step of every car. One for each car where
                it keeps something from one step to the next, as in a global.
            rules: When episodes end; those of training when left out.
            num_threads: Threads for physics and camera, the caller's included.
            seed: Seed of everything random in episodes that are begun without one of their own.
            scene: What the cameras see; built from the track when left out.
            car_parameters: The cars; the calibrated ones when left out.
            reward_deadline_s: How long one call of the reward function may take, seconds.
            on_reward_error: Takes the failure of a call and the number of calls so far, and returns
                the reward of that step instead, or raises. It is also told when a function declares
                its episode broken, with the kind `discard`; what it returns is not used then. When
                left out, every failure is raised.
            race: What else is on the track.
            sensors: What each car perceives; the front camera when left out.
            realism: Sim-to-real extras; none when left out.
            randomize: Lights and colours that change from episode to episode.
            longest_latency_s: The longest latency of conditions that `reset` will get, if that is
                longer than what `realism` draws.

        Raises:
            ValueError: The race does not fit on the track, or the number of cars not the race.
        """
        if num_cars % race.racers:
            raise ValueError(f"{num_cars} cars cannot race in groups of {race.racers}.")
        self.track = track
        self.num_cars = num_cars
        self.rules = rules or EpisodeRules()
        self.seed = seed
        self._tracks = (track, track.reversed())
        self._backward: Ints = np.zeros(num_cars, np.int64)
        self._placing = Placing(self._tracks, self._backward)
        self._race = race
        self.traffic = None if race == TIME_TRIAL else Traffic(self._tracks, num_cars, race)
        self._realism = realism or Realism()
        self._disturbances = Disturbances(num_cars)
        self._disturbs = self._realism != Realism()
        self._varies_cars = False
        self._randomizes = randomize != "nothing"
        self._observations = Observations(
            scene or build_scene(track),
            num_cars,
            num_threads,
            world=track.name,
            sensors=sensors or Sensors(),
            traffic=self.traffic,
            disturbances=self._disturbances,
            randomize=randomize,
        )
        self.frames = self._observations.frames
        self.scans = self._observations.scans
        self._cars = CarBatch(
            num_cars,
            num_threads,
            car_parameters,
            longest_latency_s=max(self._realism.longest_latency_s, longest_latency_s),
        )
        self._episodes = Episodes(num_cars, self.rules)
        self.unstable: Bools = np.zeros(num_cars, np.bool_)
        self._episodes_begun: Ints = np.zeros(num_cars, np.int64)
        self._along_m: Floats = np.zeros(num_cars)
        self._where: Location
        self._wheels_on: Ints
        self._look()
        self._ticks: Ints = np.zeros(num_cars, np.int64)
        self._reward_functions = (
            [reward_function] * num_cars if callable(reward_function) else list(reward_function)
        )
        self._reward_deadline_s = reward_deadline_s
        self._on_reward_error = on_reward_error
        self.reward_calls = 0

    def reset(
        self,
        cars: Ints,
        start_fraction: Floats,
        *,
        reverse: bool | Bools = False,
        seeds: Seeds | None = None,
        offset_m: Floats | None = None,
        angle_deg: Floats | None = None,
        conditions: Conditions | Sequence[Conditions] | None = None,
    ) -> StepResult:
        """Begin episodes: put cars on the track at rest, for the `prepare` step.

        Cars start on the centre line, or on the lane away from an obstacle that stands there;
        racers start side by side, each second one a little further back.

        Args:
            cars: Which cars, running or not. Shape (k,).
            start_fraction: Where on the lap each begins, 0 .. 1. Shape (k,).
            reverse: Drive the lap against the direction of `track`. One value or shape (k,).
            seeds: Seeds of what is random in each episode; drawn from the seed of the simulation,
                the car and the count of its episodes when left out. Shape (k,).
            offset_m: How far to the left of the centre line each car stands; less where its wheels
                would leave the road. Only for cars that start on the centre line. Shape (k,).
            angle_deg: How far each is turned to the left of the driving direction. Shape (k,).
            conditions: What the episodes are driven under, instead of what `realism` draws for
                them: one for all, or k of them. They say nothing about traffic, nor about the
                lights and colours that `randomize` draws.

        Returns:
            The first row of the episodes: status PREPARE, steps 1, reward 0.

        Raises:
            ValueError: There are not k conditions, or their latency is longer than the cars were
                built for.
        """
        cars = np.asarray(cars, np.int64)
        start_fraction = np.asarray(start_fraction, np.float64)
        if self.track.closed:
            start_fraction = start_fraction % 1.0
        self._backward[cars] = np.asarray(reverse, np.int64)
        seeds = self._episode_seeds(cars) if seeds is None else np.asarray(seeds, np.uint64)
        self._draw(cars, seeds, conditions)
        self._place_at_start(cars, start_fraction, seeds)
        if offset_m is not None or angle_deg is not None:
            self._turn_aside(cars, start_fraction, offset_m, angle_deg)
        self._observations.start(np.sort(cars), self._cars)
        self._ticks[cars] += 1
        self._look_again(cars)
        self._along_m[cars] = self._where.distance_m[cars]
        self._episodes.begin(cars, start_fraction, self._along_m[cars] / self.track.length_m)

        nobody = np.zeros(self.num_cars, np.bool_)
        nothing = np.zeros(self.num_cars)
        status = np.where(self._episodes.state.over, Status.PARK, Status.IN_PROGRESS)
        status[self._episodes.state.pause_steps > 0] = Status.PAUSE
        status[cars] = Status.PREPARE
        result = self._result(nobody, nothing, nobody, nobody, status)
        self._observations.finish()
        return result

    def step(self, steering_deg: Floats, speed_mps: Floats) -> StepResult:
        """Let all running cars act for 1/15 s; parked and waiting cars ignore their action.

        An episode that its reward function declares broken ends with the status `DISCARDED` and
        the reward 0.

        They are asked for wheel angles, left positive, and speeds. Shape (n,) each.

        Raises:
            RewardError: The reward function failed.
        """
        episodes = self._episodes
        running = ~episodes.state.over
        driven = running & (episodes.state.pause_steps == 0)
        waiting = running & ~driven
        came_from, came_yaw = self._cars.origin_xy.copy(), self._cars.yaw_rad.copy()
        self._cars.drive(steering_deg, speed_mps, driven)
        cars = self._cars
        if mark_unstable(cars.origin_xy, came_from, cars.yaw_rad, cars.lens_pos, self.unstable):
            poses = np.column_stack([came_from, came_yaw])[self.unstable]
            cars.place(np.flatnonzero(self.unstable), poses)
        if self.traffic is not None:
            self.traffic.advance(running)
            self.traffic.follow(self._cars.origin_xy, self._cars.yaw_rad)
        # A car that waits sees the traffic go on.
        sees = driven if self.traffic is None else running
        self._observations.start(np.flatnonzero(sees), self._cars)
        try:
            self._ticks[running] += 1
            self._look()
            self._follow()
            moved_m = np.hypot(*(self._cars.origin_xy - came_from).T)
            contacts = self._contacts(driven)
            crashed = contacts.crashed if contacts is not None else np.zeros_like(driven)
            fraction = self._along_m / self.track.length_m
            off_track = (self._wheels_on == 0) | self.unstable
            verdict = episodes.judge(Observed(driven, fraction, moved_m, off_track, crashed))
            episodes.wait(waiting)
            situation = self._situation(
                steering_deg, speed_mps, driven & (verdict.status == Status.CRASHED)
            )
            rewards, discarded = self._rewards(situation, driven)
            if discarded.any():
                episodes.discard(discarded, verdict)
        finally:
            self._observations.finish()
        status = np.where(waiting, Status.PAUSE, np.where(driven, verdict.status, Status.PARK))
        result = self._result(driven, rewards, verdict.terminated, verdict.truncated, status)
        if verdict.put_back.any():
            self._put_back(np.flatnonzero(verdict.put_back), verdict.status, came_from, contacts)
        if self._race.racers > 1 and result.done.any():
            done = np.flatnonzero(result.done)
            self._cars.place(done, self._placing.aside(done, fraction[done]))
        return result

    @property
    def observations(self) -> Bytes:
        """Current camera frames of the first eye, grey. A live view. Shape (n, 120, 160)."""
        return self.frames[:, 0]

    @property
    def poses(self) -> Floats:
        """Origins of the cars, x and y in metres, and yaws in radians. Shape (n, 3)."""
        return np.column_stack([self._cars.origin_xy, self._cars.yaw_rad])

    def privileged(self, cars: Ints) -> Singles:
        """The `privileged_features` of some cars, shape (k,). Shape (k, PRIVILEGED_DIMS)."""
        here = np.column_stack([self._cars.front_xy[cars], self._cars.yaw_rad[cars]])
        return features(
            self._tracks,
            cars,
            self._backward[cars],
            here,
            self._cars.speed[cars],
            self._along_m[cars],
            self.traffic,
        )

    def close(self) -> None:
        """Stop the threads that render."""
        self._observations.close()

    def _episode_seeds(self, cars: Ints) -> Seeds:
        """A seed for the next episode of each car. Racers of one group meet the same traffic."""
        if self.traffic is None and not (self._disturbs or self._randomizes):
            return np.zeros(len(cars), np.uint64)  # nothing is drawn
        groups = cars // self._race.racers
        seeds = [
            np.random.SeedSequence([self.seed, group, count]).generate_state(1, np.uint64)[0]
            for group, count in zip(
                groups.tolist(), self._episodes_begun[cars].tolist(), strict=True
            )
        ]
        self._episodes_begun[cars] += 1
        return np.array(seeds, np.uint64)

    def _draw(
        self, cars: Ints, seeds: Seeds, conditions: Conditions | Sequence[Conditions] | None
    ) -> None:
        """Draw lights, colours, camera and car of new episodes."""
        racers = cars % self._race.racers
        if self._randomizes:
            for car, *key in zip(cars.tolist(), seeds.tolist(), racers.tolist(), strict=True):
                random = np.random.Generator(np.random.Philox(key=np.array(key, np.uint64)))
                self._observations.draw(car, random)
        if conditions is None and not self._disturbs:
            return
        if conditions is None:
            keys = zip(seeds.tolist(), racers.tolist(), strict=True)
            each = [self._realism.draw(seed, racer) for seed, racer in keys]
        else:
            each = [conditions] * len(cars) if isinstance(conditions, Conditions) else [*conditions]
            if len(each) != len(cars):
                raise ValueError(f"There are {len(each)} conditions for {len(cars)} episodes.")
            self._disturbs = True  # the next episode must not keep these
        for car, drawn in zip(cars.tolist(), each, strict=True):
            self._disturbances.begin(car, drawn)
            self._observations.light(car, drawn)
        self._varies_cars = self._varies_cars or any(drawn.changes_car for drawn in each)
        if self._varies_cars:
            self._cars.vary(cars, self._disturbances.variation)

    def _place_at_start(self, cars: Ints, start_fraction: Floats, seeds: Seeds) -> None:
        if self.traffic is None:
            self._cars.place(cars, self._placing.on(cars, start_fraction))
            return
        self.traffic.begin(cars, start_fraction, self._backward[cars], seeds)
        fraction = start_fraction - self.traffic.start_gap_m(cars) / self.track.length_m
        lanes = self.traffic.start_lane(cars)
        self._cars.place(cars, self._placing.on_each(cars, fraction, lanes))
        self.traffic.follow(self._cars.origin_xy, self._cars.yaw_rad)

    def _turn_aside(
        self, cars: Ints, fraction: Floats, offset_m: Floats | None, angle_deg: Floats | None
    ) -> None:
        """Move cars from where they start on the centre line; turn cars on other lanes only."""
        nothing = np.zeros(len(cars))
        offset_m = nothing if offset_m is None else np.asarray(offset_m, np.float64)
        angle_deg = nothing if angle_deg is None else np.asarray(angle_deg, np.float64)
        on_line = np.ones(len(cars), np.bool_)
        if self.traffic is not None:
            on_line = self.traffic.start_lane(cars) == CENTER
        poses = self.poses[cars]
        for k in np.flatnonzero((offset_m != 0.0) | (angle_deg != 0.0)):
            if on_line[k]:
                track = self._tracks[self._backward[cars[k]]]
                poses[k] = start_pose(track, fraction[k], offset_m[k], angle_deg[k]).pose
            else:
                poses[k, 2] += np.radians(angle_deg[k])
        self._cars.place(cars, poses)
        if self.traffic is not None:
            self.traffic.follow(self._cars.origin_xy, self._cars.yaw_rad)

    def _contacts(self, driven: Bools) -> Contacts | None:
        if self.traffic is None:
            return None
        return self.traffic.contacts(
            driven, self._cars.origin_xy, self._cars.yaw_rad, self._along_m
        )

    def _put_back(
        self, cars: Ints, status: Ints, came_from: Floats, contacts: Contacts | None
    ) -> None:
        """Place cars whose violation is forgiven where they go on.

        After a crash into another car a car stays where it is. Otherwise it goes where it was
        before the violation, on the lane nearer to it, clear of obstacles.
        """
        state = self._episodes.state
        stays = np.zeros(len(cars), np.bool_)
        progress = state.previous_progress[cars]
        if contacts is not None:
            into = status[cars] == Status.CRASHED
            stays = into & ~contacts.other_stands[cars]
            progress = np.where(into, state.progress[cars], progress)
        fraction = fraction_at(progress, state.start_fraction[cars])
        lanes = self._placing.nearer_lane(cars, fraction, came_from[cars])
        if self.traffic is not None:
            moved = ~stays
            fraction[moved], lanes[moved] = self.traffic.clear_of(
                cars[moved], fraction[moved], lanes[moved]
            )
        poses = self._placing.on_each(cars, fraction, lanes)
        here = np.column_stack([self._cars.origin_xy[cars], self._cars.yaw_rad[cars]])
        self._cars.place(cars, np.where(stays[:, None], here, poses))
        self._look_again(cars)
        self._along_m[cars] = self._where.distance_m[cars]
        self._episodes.put_back(cars, self._along_m[cars] / self.track.length_m)
        if self.traffic is not None:
            self.traffic.follow(self._cars.origin_xy, self._cars.yaw_rad)
        self._observations.start(cars, self._cars)
        self._observations.finish()

    def _look(self) -> None:
        """Find where all cars are on the track."""
        self._where = self._tracks[0].locate(self._cars.front_xy)
        self._wheels_on = self.track.on_road(self._cars.wheel_xy).sum(axis=1)
        if self._backward.any():
            self._scatter(np.flatnonzero(self._backward), self._tracks[1])

    def _look_again(self, cars: Ints) -> None:
        """Find where some cars are that have been placed; the others have not moved."""
        # Rows that were handed out stay as they are.
        self._where = Location._make(column.copy() for column in self._where)
        self._wheels_on = self._wheels_on.copy()
        self._wheels_on[cars] = self.track.on_road(self._cars.wheel_xy[cars]).sum(axis=1)
        for direction, track in enumerate(self._tracks):
            self._scatter(cars[self._backward[cars] == direction], track)

    def _scatter(self, cars: Ints, track: Track) -> None:
        """Write where some cars are on their track over what is known."""
        if len(cars):
            where = track.locate(self._cars.front_xy[cars])
            for known, column in zip(self._where, where, strict=True):
                known[cars] = column

    def _follow(self) -> None:
        """Keep how far along the line each car is, without jumps to neighbouring stretches."""
        along_m = self._where.distance_m.copy()
        for car in np.flatnonzero(np.abs(along_m - self._along_m) > JUMP_M):
            track = self._tracks[self._backward[car]]
            along_m[car] = without_jump(
                track, self._cars.front_xy[car], along_m[car], self._along_m[car]
            )
        self._along_m = along_m

    def _situation(self, steering_deg: Floats, speed_mps: Floats, crashed: Bools) -> Situation:
        return Situation(
            xy=self._cars.front_xy,
            heading_deg=np.degrees(self._cars.yaw_rad),
            where=self._where,
            all_on=self._wheels_on == len(WHEELS_M),
            none_on=self._wheels_on == 0,
            progress=self._episodes.state.progress,
            steps=self._episodes.state.steps,
            sim_time_s=self._ticks / CONTROL_HZ,
            steering_deg=np.asarray(steering_deg, np.float64),
            speed_mps=np.asarray(speed_mps, np.float64),
            backward=self._backward,
            crashed=crashed,
            objects=None if self.traffic is None else self.traffic.objects(),
        )

    def _rewards(self, situation: Situation, driven: Bools) -> tuple[Floats, Bools]:
        """The rewards of all cars, and whose episodes their functions declare broken."""
        cars = np.flatnonzero(driven)
        rewards = np.zeros(self.num_cars)
        discarded = np.zeros(self.num_cars, np.bool_)

        def instead(call: int, error: RewardError) -> float:
            made = begun + call + 1
            if error.kind == "discard":
                discarded[cars[call]] = True
                if self._on_reward_error is not None:
                    self._on_reward_error(error, made)
                return 0.0
            if self._on_reward_error is None:
                raise error from error.__cause__
            return self._on_reward_error(error, made)

        begun = self.reward_calls
        self.reward_calls += len(cars)
        calls = params_of(self._tracks, situation, cars)
        own = [self._reward_functions[car] for car in cars.tolist()]
        rewards[cars] = checked_rewards(own, calls, self._reward_deadline_s, instead)
        return rewards, discarded

    def _result(
        self,
        driven: Bools,
        reward: Floats,
        terminated: Bools,
        truncated: Bools,
        status: Ints,
    ) -> StepResult:
        state, where = self._episodes.state, self._where
        x, y = self._cars.front_xy.T.copy()
        return StepResult(
            driven=driven,
            reward=reward,
            terminated=terminated,
            truncated=truncated,
            status=status,
            progress=state.progress.copy(),
            x=x,
            y=y,
            yaw_deg=np.degrees(self._cars.yaw_rad),
            all_wheels_on_track=self._wheels_on == len(WHEELS_M),
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

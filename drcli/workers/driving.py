"""Drives episodes side by side: one batch of cars, one policy, whole episodes out."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from drcli.exchange.trace import STEP_S, Episode, Phase, Row
from drcli.learn.policy import Decision, Observation, Policy, decide
from drcli.workers import print_limit
from drcli.workers.worker_process import StopRequested
from drsim.car.actions import Actions, ContinuousActions
from drsim.episode.episode import Status
from drsim.episode.simulation import Simulation
from drsim.episode.step import StepResult

DRAWS = 256
"""Random numbers drawn at a time for an episode."""


@dataclass(frozen=True)
class Plan:
    """An episode to be driven.

    Attributes:
        number: As in `Episode`.
        phase: Training samples from the policy, evaluation takes its most likely action.
        start_fraction: Where on the lap it starts, 0 to 1.
        reverse: Whether it drives against the direction of the simulation's track.
        racer: Which pilot drives it, in a race of several.
    """

    number: int
    phase: Phase
    start_fraction: float
    reverse: bool = False
    racer: int = 0

    def seed(self, run: int) -> int:
        """Seed of what is random in the episode's world.

        The same for all racers of one race, and for an evaluation episode the same with every
        checkpoint, so that checkpoints can be compared.
        """
        words = [run, self.number, int(self.phase == "evaluation")]
        return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0])


@dataclass
class Driven(Episode):
    """An episode with what the learner wants to know of each step but the first.

    Attributes:
        frames: What the car saw. Each of shape (eyes, 120, 160).
        scans: What its lidar told. Each of shape (scan_dims,).
        states: What only the critic was told. Each of shape (state_dims,).
        actions: What was chosen: an index, or unclipped values of shape (dims,).
        log_probs: Log-probability of the choice.
        values: The critic's estimate.
        racer: Which pilot drove it.
        cut: Whether the step limit ended it.
        last_value: What the critic still expected when it was cut; else 0.
    """

    racer: int = 0
    frames: list[NDArray[np.uint8]] = field(default_factory=list)
    scans: list[NDArray[np.float32]] = field(default_factory=list)
    states: list[NDArray[np.float32]] = field(default_factory=list)
    actions: list[NDArray[np.float32] | int] = field(default_factory=list)
    log_probs: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    cut: bool = False
    last_value: float = 0.0


class _Lane:
    """A car and the episode it is driving.

    Attributes:
        plan: What was planned.
        episode: What has been driven.
        seen: The frames the policy sees together, oldest first. Each of shape (eyes, 120, 160).
    """

    def __init__(self, plan: Plan, seed: int, pilot: "Pilot", first: "_Columns", car: int) -> None:
        self.plan = plan
        self.seen: deque[NDArray[np.uint8]] = deque(maxlen=pilot.model.spec.stack)
        self.episode = Driven(plan.number, plan.phase, racer=plan.racer)
        # The clock of the car has taken the first step already; the episode began before it.
        self._began_s = first.sim_time_s[car] - STEP_S
        self._first = first
        # An episode draws the same numbers wherever, whenever and beside whichever others it is
        # driven, so that an iteration that has to be repeated is the same.
        self._draw = np.random.Generator(
            np.random.Philox(key=np.array([seed, plan.number], np.uint64))
        )
        self._noise_dims = pilot.model.spec.noise_dims
        self._block = np.empty((0, self._noise_dims), dtype=np.float32)
        self._normal = pilot.model.spec.continuous
        self._used = 0

    def look(self, frame: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
        """Take in a frame; before the beginning of an episode its first frame repeats."""
        self.seen.extend([frame] * (1 if self.seen else self.seen.maxlen or 1))
        return list(self.seen)

    def record(self, columns: "_Columns", car: int, request: Sequence[float], label: str) -> None:
        """Add a row; the first step of an episode carries the first action that was chosen."""
        rows = self.episode.rows
        if not rows:
            rows.append(self._first.row(car, request, label, self._began_s))
        rows.append(columns.row(car, request, label, self._began_s))

    def noise(self) -> NDArray[np.float32]:
        if self._used == len(self._block):
            shape = (DRAWS, self._noise_dims)
            self._block = (
                self._draw.standard_normal(shape, dtype=np.float32)
                if self._normal
                else self._draw.random(shape, dtype=np.float32)
            )
            self._used = 0
        self._used += 1
        row: NDArray[np.float32] = self._block[self._used - 1]
        return row


@dataclass(frozen=True, eq=False)
class Pilot:
    """A policy and what its choices mean."""

    model: Policy
    actions: Actions

    @property
    def continuous(self) -> bool:
        """Whether it chooses values rather than one of a list."""
        return isinstance(self.actions, ContinuousActions)


class Driver:
    """A simulation with a policy at every wheel."""

    def __init__(self, simulation: Simulation, pilots: Sequence[Pilot], seed: int) -> None:
        """Seat the pilots.

        Args:
            simulation: The cars. In a race of several, car k belongs to racer k modulo their
                number, and must be given that racer's plans.
            pilots: One for each racer.
            seed: Start of all random numbers.
        """
        self._simulation = simulation
        self._pilots = pilots
        self._seed = seed
        self._epsilon: Callable[[int], float] | None = None
        self._trained = 0

    def drive(
        self,
        plans: Sequence[Plan],
        on_episode: Callable[[Driven], None],
        should_stop: Callable[[], bool] = lambda: False,
        epsilon: Callable[[int], float] | None = None,
    ) -> None:
        """Drive all planned episodes, as many at a time as there are cars.

        Args:
            plans: In the order in which cars take them up. In a race of several, those of one race
                side by side, and never more plans than cars: races are not begun by halves.
            on_episode: Called with each episode as soon as it is over.
            should_stop: Asked at every step.
            epsilon: The share of training actions that are drawn blindly, by the training steps
                driven in this call, where the others are the most likely ones; None where all are
                drawn from the policy.

        Raises:
            StopRequested: When `should_stop` said so.
        """
        self._epsilon = epsilon
        self._trained = 0
        waiting = deque(plans)
        lanes: list[_Lane | None] = [None] * self._simulation.num_cars
        self._fill(lanes, waiting)
        while any(lane is not None for lane in lanes):
            if should_stop():
                raise StopRequested
            ended = self._step(lanes)
            for car in ended:
                lane = lanes[car]
                lanes[car] = None
                if lane is not None:
                    on_episode(lane.episode)
            if ended and waiting:
                self._fill(lanes, waiting)

    def _fill(self, lanes: list[_Lane | None], waiting: deque[Plan]) -> None:
        """Put waiting episodes into free cars."""
        free = [car for car, lane in enumerate(lanes) if lane is None][: len(waiting)]
        if not free:
            return
        plans = [waiting.popleft() for _ in free]
        with print_limit.limited_prints():
            first = self._simulation.reset(
                np.array(free),
                np.array([plan.start_fraction for plan in plans]),
                reverse=np.array([plan.reverse for plan in plans]),
                seeds=np.array([plan.seed(self._seed) for plan in plans], np.uint64),
            )
        columns = _Columns.of(first)
        for car, plan in zip(free, plans, strict=True):
            lanes[car] = _Lane(plan, self._seed, self._pilots[plan.racer], columns, car)

    def _step(self, lanes: list[_Lane | None]) -> list[int]:
        """One step of all cars that drive.

        Returns:
            The cars whose episode ended.
        """
        driving = [(car, lane) for car, lane in enumerate(lanes) if lane is not None]
        steering, speed = np.zeros(len(lanes)), np.zeros(len(lanes))
        chosen = []
        for pilot, seats in self._grouped(driving):
            chosen.append((pilot, seats, *self._decide(pilot, seats, steering, speed)))
        with print_limit.limited_prints():
            columns = _Columns.of(self._simulation.step(steering, speed))
        for pilot, seats, observed, decision in chosen:
            _record(pilot, seats, observed, decision, (steering, speed), columns)
            cut = [(car, lane) for car, lane in seats if columns.truncated[car]]
            if cut:
                self._expect(pilot, cut)
        self._trained += sum(lane.plan.phase == "training" for _, lane in driving)
        return [car for car, _ in driving if columns.done[car]]

    def _grouped(
        self, driving: Sequence[tuple[int, _Lane]]
    ) -> Iterator[tuple[Pilot, list[tuple[int, _Lane]]]]:
        """Cars that choose together: those of one pilot and one phase.

        How many rows a matrix product has decides how each of them is rounded. The clock decides
        whether a checkpoint is evaluated, so evaluation episodes must not be among the rows of the
        training episodes: equal seeds would not train equally.
        """
        for racer, pilot in enumerate(self._pilots):
            for phase in ("training", "evaluation"):
                seats = [
                    (car, lane)
                    for car, lane in driving
                    if (lane.plan.racer, lane.plan.phase) == (racer, phase)
                ]
                if seats:
                    yield pilot, seats

    def _decide(
        self,
        pilot: Pilot,
        seats: list[tuple[int, "_Lane"]],
        steering: NDArray[np.float64],
        speed: NDArray[np.float64],
    ) -> tuple["_Observed", Decision]:
        """Let a pilot choose for all its cars, and write its requests down.

        Returns:
            What the cars perceived, and what was chosen.
        """
        cars = np.array([car for car, _ in seats])
        observed = self._observe(pilot, seats)
        noise = np.stack([lane.noise() for _, lane in seats])
        deterministic = np.array([lane.plan.phase == "evaluation" for _, lane in seats])
        epsilon = None if self._epsilon is None else self._epsilon(self._trained)
        decision = decide(pilot.model, observed.together, noise, deterministic, epsilon)
        steering[cars], speed[cars] = pilot.actions.requests(decision.actions)
        return observed, decision

    def _observe(self, pilot: Pilot, seats: list[tuple[int, "_Lane"]]) -> "_Observed":
        """What the cars of a pilot perceive now."""
        cars = np.array([car for car, _ in seats])
        spec = pilot.model.spec
        frames = self._simulation.frames[cars]
        scans = self._simulation.scans[cars]
        states = (
            self._simulation.privileged(cars)
            if spec.state_dims
            else np.empty((len(cars), 0), np.float32)
        )
        stacked = frames
        if spec.stack > 1:
            looks = zip(seats, frames, strict=True)
            stacked = np.stack([np.concatenate(lane.look(frame)) for (_, lane), frame in looks])
        return _Observed(frames, scans, states, Observation.of_arrays(stacked, scans, states))

    def _expect(self, pilot: Pilot, cut: list[tuple[int, "_Lane"]]) -> None:
        """Ask the critic what the rest of episodes would have brought that were cut off."""
        noise = np.zeros((len(cut), pilot.model.spec.noise_dims), np.float32)
        observed = self._observe(pilot, cut)
        decision = decide(pilot.model, observed.together, noise, np.ones(len(cut), np.bool_))
        for (_, lane), value in zip(cut, decision.values.tolist(), strict=True):
            lane.episode.cut = True
            lane.episode.last_value = value


@dataclass(frozen=True)
class _Observed:
    """What some cars perceive: each frame by itself, and everything as the policy takes it."""

    frames: NDArray[np.uint8]
    scans: NDArray[np.float32]
    states: NDArray[np.float32]
    together: Observation


def _record(
    pilot: Pilot,
    seats: list[tuple[int, _Lane]],
    observed: _Observed,
    decision: Decision,
    requests: tuple[NDArray[np.float64], NDArray[np.float64]],
    columns: "_Columns",
) -> None:
    """Add a step to the episodes of a pilot's cars."""
    cars = [car for car, _ in seats]
    steering, speed = requests
    choices = zip(
        seats,
        observed.frames,
        observed.scans,
        observed.states,
        decision.actions if pilot.continuous else decision.actions.tolist(),
        zip(steering[cars].tolist(), speed[cars].tolist(), strict=True),
        decision.log_probs.tolist(),
        decision.values.tolist(),
        strict=True,
    )
    for (car, lane), frame, scan, state, action, request, log_prob, value in choices:
        label = f"[{request[0]} {request[1]}]" if pilot.continuous else str(action)
        lane.record(columns, car, request, label)
        if lane.plan.phase == "training":
            episode = lane.episode
            episode.frames.append(frame)
            episode.scans.append(scan)
            episode.states.append(state)
            episode.actions.append(action)
            episode.log_probs.append(log_prob)
            episode.values.append(value)


@dataclass(frozen=True)
class _Columns:
    """A step's results as plain Python values, one list a column: rows are made car by car."""

    steps: list[int]
    x: list[float]
    y: list[float]
    yaw_deg: list[float]
    reward: list[float]
    done: list[bool]
    truncated: list[bool]
    all_wheels_on_track: list[bool]
    progress: list[float]
    closest_waypoint: list[int]
    status: list[int]
    pause_s: list[float]
    sim_time_s: list[float]
    crashes: list[int]

    @staticmethod
    def of(result: StepResult) -> "_Columns":
        return _Columns(*(getattr(result, f.name).tolist() for f in fields(_Columns)))

    def row(self, car: int, request: Sequence[float], label: str, began_s: float) -> Row:
        return Row(
            steps=self.steps[car],
            x=self.x[car],
            y=self.y[car],
            yaw_deg=self.yaw_deg[car],
            steering_deg=request[0],
            speed_mps=request[1],
            action=label,
            reward=self.reward[car],
            done=self.done[car],
            all_wheels_on_track=self.all_wheels_on_track[car],
            progress=self.progress[car],
            closest_waypoint=self.closest_waypoint[car],
            status=STATUS_WORDS[self.status[car]],
            pause_s=self.pause_s[car],
            time_s=self.sim_time_s[car] - began_s,
            crashes=self.crashes[car],
        )


STATUS_WORDS = [status.label for status in Status]
"""Words of the trace by the simulation's status numbers."""

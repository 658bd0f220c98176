"""Drives many episodes at a time: a batch of cars and one policy."""

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from time import time as unix_s
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.base import log
from drcli.base.log import get_logger
from drcli.learn.cuda import GpuPolicy
from drcli.learn.policy import Decision, Observation, Policy, PolicySpec, decide
from drcli.learn.rollout_buffer import Rollout
from drcli.live.step_snapshot import LiveObserver, Look, Rider, StepSnapshot
from drcli.records.episode_metrics import TrialMetrics
from drcli.records.iteration import lap_time
from drcli.records.rollout import Episodes
from drcli.records.trace import STATUS_LABELS, STEP_S, Episode, Phase, Row
from drcli.workers.worker_process import StopRequested
from drsim.car.actions import Actions
from drsim.car.conditions import Conditions
from drsim.episode.episode_rules import Status, StepResult
from drsim.episode.simulation import Simulation
from drsim.race.traffic import Traffic
from drsim.track.track import Track

# An episode of a worker: what is planned, and what the learner gets of it.


@dataclass(frozen=True)
class Plan:
    """An episode to drive.

    Attributes:
        phase: Training samples from the policy, evaluation takes its most likely action.
        start_fraction: Of the lap.
        attempt: How often it was declared broken before.
        offset_m: To the left of the centre line.
        angle_deg: To the left.
        conditions: Instead of what the settings draw.
        world: Decides the seed; None for its own number.
        track: Index into the tracks of the simulation.
    """

    number: int
    phase: Phase
    start_fraction: float
    reverse: bool = False
    racer: int = 0
    attempt: int = 0
    offset_m: float = 0.0
    angle_deg: float = 0.0
    conditions: Conditions | None = None
    world: int | None = None
    track: int = 0

    def seed(self, run: int) -> int:
        """Seed of everything random in the episode's world.

        It is the same for all racers of a race, and for each checkpoint of an evaluation, so
        that these can be compared.
        """
        number = self.number if self.world is None else self.world
        words = [run, number, int(self.phase == "evaluation")]
        if self.attempt:
            words.append(self.attempt)
        return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0])


Sample = tuple[
    NDArray[np.uint8],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32] | int,
    float,
    float,
    bool,
]
"""The learner's data of a step: frame of shape (eyes, 120, 160), lidar of shape (scan_dims,), state
of shape (state_dims,), which only the critic sees, action, an index or unclipped values of shape
(dims,), its log-probability, the critic's estimate, and whether the reward is known.
"""


@dataclass
class Driven(Episode):
    """An episode with what the learner needs.

    Attributes:
        samples: Of each step except the first.
        cut: The step limit ended it.
        last_value: The critic's estimate of the rest then.
        objects: x, y and yaw of what was around the car at each row. Each of shape (k, 3).
        track: Index into the tracks of the simulation.
    """

    racer: int = 0
    track: int = 0
    samples: list[Sample] = field(default_factory=list)
    cut: bool = False
    last_value: float = 0.0
    objects: list[NDArray[np.float64]] = field(default_factory=list)


def columns_of(driven: Sequence[Driven]) -> tuple[list[float], list[float], list[float]]:
    """Progress in percent, reward, and times of completed laps."""
    return (
        [float(e.progress) for e in driven],
        [float(e.reward) for e in driven],
        [float(e.duration_s) for e in driven if e.completed],
    )


def rollout_of(driven: Sequence[Driven]) -> Rollout:
    """None of the episodes may be discarded: nobody may learn from these."""
    frames, scans, states, actions, log_probs, values, learned = zip(
        *(sample for e in driven for sample in e.samples), strict=True
    )
    return Rollout(
        frames=np.stack(frames),
        actions=np.array(actions),
        log_probs=np.array(log_probs, np.float32),
        values=np.array(values),
        rewards=np.array([row.reward for e in driven for row in e.rows[1:]]),
        lengths=np.array([e.steps for e in driven]),
        last_values=np.array([e.last_value for e in driven]),
        cut=np.array([e.cut for e in driven]),
        scans=np.stack(scans),
        states=np.stack(states),
        learned=np.array(learned),
    )


def episodes_of(driven: Sequence[Driven]) -> Episodes:
    """The samples of the episodes are freed."""
    rollout = rollout_of(driven)
    for episode in driven:
        episode.samples.clear()
    return Episodes(
        rollout,
        numbers=np.array([e.number for e in driven]),
        progress=np.array([e.progress for e in driven]),
        completed=np.array([e.completed for e in driven]),
        duration_s=np.array([e.duration_s for e in driven]),
    )


_logger = get_logger(__name__)

DRAWS = 256
STATUS_WORDS = [status.label for status in Status]


@dataclass(frozen=True, eq=False)
class Racer:
    model: Policy
    actions: Actions


class _Seat:
    def __init__(
        self, car: int, plan: Plan, racer: Racer, seed: int, first: StepResult, track: Track
    ) -> None:
        spec = racer.model.spec
        self.car = car
        self.plan = plan
        self.racer = racer
        self.track = track
        self.episode = Driven(
            plan.number,
            plan.phase,
            racer=plan.racer,
            track=plan.track,
            track_length_m=track.length_m,
        )
        self.noise = _noise(spec, seed, plan)
        self._seen: deque[NDArray[np.uint8]] = deque(maxlen=spec.stack)
        # The reset already took a step of the car's clock, and the episode began before it.
        self._began_s = first.sim_time_s.item(car) - STEP_S
        self._first = first

    def stacked(self, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Oldest first; the first frame stands for those before it."""
        self._seen.extend([frame] * (1 if self._seen else self._seen.maxlen or 1))
        return np.concatenate(self._seen)

    def record(self, result: StepResult, request: Sequence[float], label: str) -> None:
        """The first row carries the first action that was chosen."""
        rows = self.episode.rows
        if not rows:
            rows.append(self._row(self._first, request, label))
        rows.append(self._row(result, request, label))

    def _row(self, result: StepResult, request: Sequence[float], label: str) -> Row:
        car = self.car
        return Row(
            steps=result.steps.item(car),
            x=result.x.item(car),
            y=result.y.item(car),
            yaw_deg=result.yaw_deg.item(car),
            steering_deg=request[0],
            speed_mps=request[1],
            action=label,
            reward=result.reward.item(car),
            done=result.done.item(car),
            all_wheels_on_track=result.all_wheels_on_track.item(car),
            progress=result.progress.item(car),
            closest_waypoint=result.closest_waypoint.item(car),
            status=STATUS_WORDS[result.status.item(car)],
            pause_s=result.pause_s.item(car),
            time_s=result.sim_time_s.item(car) - self._began_s,
            crashes=result.crashes.item(car),
            reward_ms=1000.0 * result.reward_time_s.item(car),
        )


def _noise(spec: PolicySpec, seed: int, plan: Plan) -> Iterator[NDArray[np.float32]]:
    """By seed, number and attempt only, so that an iteration driven again is the same."""
    key = np.array([seed, plan.number + (plan.attempt << 48)], np.uint64)
    random = np.random.Generator(np.random.Philox(key=key))
    draw = random.standard_normal if spec.continuous else random.random
    while True:
        yield from draw((DRAWS, spec.noise_dims), dtype=np.float32)


class Driver:
    """Drives the cars of a simulation with the policies of one or more racers.

    Car k belongs to racer k modulo their number and must get its plans. `keeps_objects` is for
    videos.
    """

    def __init__(
        self,
        simulation: Simulation,
        racers: Sequence[Racer],
        seed: int,
        *,
        keeps_objects: bool = False,
        observer: LiveObserver | None = None,
    ) -> None:
        """Prepare; the `observer` changes nothing about the driving."""
        self._simulation = simulation
        self._racers = racers
        self._seed = seed
        self._frames = None  # on the GPU
        if simulation.device_frames is not None:
            self._frames = torch.as_tensor(simulation.device_frames, device="cuda")
        self._traffic = simulation.traffic if keeps_objects else None
        self._observer = observer

    def drive(
        self,
        plans: Sequence[Plan],
        on_episode: Callable[[Driven], None],
        should_stop: Callable[[], bool] = lambda: False,
        epsilon: Callable[[int], float] | None = None,
        cars: range | None = None,
    ) -> None:
        """Drive all planned episodes, as many at a time as there are cars.

        Args:
            plans: In this order. With several racers, the plans of a race follow each other,
                with a car for each.
            on_episode: Called when an episode ends.
            should_stop: Asked at every step.
            epsilon: For e-greedy: the share of uniform actions, by training steps of this call.
            cars: Which ones drive.

        Raises:
            StopRequested: `should_stop` returned True.
        """
        cars = range(self._simulation.num_cars) if cars is None else cars
        trained = 0
        waiting = deque(plans)
        seats: dict[int, _Seat] = {}
        while waiting or seats:
            self._fill(seats, waiting, cars)
            if should_stop():
                raise StopRequested
            driving = [seats[car] for car in sorted(seats)]
            for seat in self._step(driving, None if epsilon is None else epsilon(trained)):
                episode = seats.pop(seat.car).episode
                if self._observer is not None:
                    self._observer.ended(episode, episode.racer, seat.track.name)
                on_episode(episode)
            trained += sum(seat.plan.phase == "training" for seat in driving)

    def driven(
        self,
        plans: Sequence[Plan],
        should_stop: Callable[[], bool] = lambda: False,
        cars: range | None = None,
    ) -> list[Driven]:
        """The same; the episodes by their numbers."""
        found: list[Driven] = []
        self.drive(plans, found.append, should_stop, cars=cars)
        return sorted(found, key=lambda episode: episode.number)

    def _fill(self, seats: dict[int, _Seat], waiting: deque[Plan], cars: range) -> None:
        free = [car for car in cars if car not in seats]
        plans = [waiting.popleft() for _ in free[: len(waiting)]]
        if not plans:
            return
        moved = any(plan.offset_m or plan.angle_deg for plan in plans)
        first = self._simulation.reset(
            np.array(free[: len(plans)]),
            np.array([plan.start_fraction for plan in plans]),
            track=np.array([plan.track for plan in plans]),
            reverse=np.array([plan.reverse for plan in plans]),
            seeds=np.array([plan.seed(self._seed) for plan in plans], np.uint64),
            offset_m=np.array([plan.offset_m for plan in plans]) if moved else None,
            angle_deg=np.array([plan.angle_deg for plan in plans]) if moved else None,
            conditions=_conditions(plans),
        )
        for car, plan in zip(free, plans, strict=False):
            track = self._simulation.tracks[plan.track]
            seats[car] = _Seat(car, plan, self._racers[plan.racer], self._seed, first, track)

    def _step(self, driving: Sequence[_Seat], epsilon: float | None) -> list[_Seat]:
        steering = np.zeros(self._simulation.num_cars)
        speed = np.zeros_like(steering)
        chosen = []
        for group in _groups(driving):
            racer, cars = group[0].racer, [seat.car for seat in group]
            frames, seen = self._observe(group)
            noise = np.stack([next(seat.noise) for seat in group])
            deterministic = np.array([seat.plan.phase == "evaluation" for seat in group])
            taken = self._on_device(racer.model, cars, seen)
            decision = decide(racer.model, taken, noise, deterministic, epsilon)
            steering[cars], speed[cars] = racer.actions.requests(decision.actions)
            chosen.append((group, frames, seen, decision))
        result = self._simulation.step(steering, speed)
        if self._simulation.unstable.any():
            _tell_of_unstable([seat for seat in driving if self._simulation.unstable[seat.car]])
        for group, frames, seen, decision in chosen:
            _record(group, frames, seen, decision, (steering, speed), result)
            if self._traffic is not None:
                self._keep_objects(group, self._traffic)
            cut = [
                seat for seat in group if result.truncated[seat.car] and not seat.episode.discarded
            ]
            if cut:
                self._expect(cut)
        if self._observer is not None and self._observer.wanted:
            self._observer.see(self._moment(driving, chosen, (steering, speed), result))
        return [seat for seat in driving if result.done[seat.car]]

    def _moment(
        self,
        driving: Sequence[_Seat],
        chosen: Sequence[tuple[Sequence[_Seat], NDArray[np.uint8], Observation, Decision]],
        requests: tuple[NDArray[np.float64], NDArray[np.float64]],
        result: StepResult,
    ) -> StepSnapshot:
        simulation, traffic = self._simulation, self._simulation.traffic
        objects = np.empty((simulation.num_cars, 0, 3))
        if traffic is not None:
            objects = np.concatenate([traffic.xy, traffic.yaw_rad[:, :, None]], axis=2)
        return StepSnapshot(
            unix_s(),
            result,
            simulation.poses,
            simulation.speeds_mps,
            *requests,
            riders=[
                Rider(
                    seat.car,
                    seat.plan.racer,
                    seat.plan.number,
                    seat.plan.phase,
                    seat.track,
                    seat.plan.reverse,
                    seat.episode.rows,
                    len(seat.episode.rows),
                )
                for seat in driving
            ],
            looks=[
                Look(
                    [seat.car for seat in group],
                    frames,
                    seen,
                    decision,
                    group[0].racer.model,
                    group[0].racer.actions,
                )
                for group, frames, seen, decision in chosen
            ],
            shapes=() if traffic is None else traffic.shapes,
            objects=objects,
        )

    @staticmethod
    def _keep_objects(group: Sequence[_Seat], traffic: Traffic) -> None:
        """For videos; the first two rows share a place."""
        for seat in group:
            poses = np.column_stack([traffic.xy[seat.car], traffic.yaw_rad[seat.car]])
            missing = len(seat.episode.rows) - len(seat.episode.objects)
            seat.episode.objects.extend([poses] * missing)

    def _observe(self, group: Sequence[_Seat]) -> tuple[NDArray[np.uint8], Observation]:
        cars = np.array([seat.car for seat in group])
        spec = group[0].racer.model.spec
        drawn = self._simulation.frames
        frames = drawn[cars] if self._simulation.draws else drawn[cars, :, :0, :0]
        states = np.empty((len(cars), 0), np.float32)
        if spec.taught:
            states = self._simulation.teacher_state(cars)
        elif spec.state_dims:
            states = self._simulation.privileged(cars)
        stacked = frames
        if spec.stack > 1:
            looks = zip(group, frames, strict=True)
            stacked = np.stack([seat.stacked(frame) for seat, frame in looks])
        return frames, Observation.of_arrays(stacked, self._simulation.scans[cars], states)

    def _on_device(self, policy: Policy, cars: list[int], seen: Observation) -> Observation:
        """With frames that are on the GPU already, if the policy chooses there."""
        if self._frames is None or policy.spec.stack > 1 or not isinstance(policy, GpuPolicy):
            return seen
        return seen._replace(frames=self._frames[cars])

    def _expect(self, cut: Sequence[_Seat]) -> None:
        """The critic's value of the rest after the step limit."""
        model = cut[0].racer.model
        noise = np.zeros((len(cut), model.spec.noise_dims), np.float32)
        _, seen = self._observe(cut)
        decision = decide(model, seen, noise, np.ones(len(cut), np.bool_))
        for seat, value in zip(cut, decision.values.tolist(), strict=True):
            seat.episode.cut = True
            seat.episode.last_value = value


def _conditions(plans: Sequence[Plan]) -> list[Conditions] | None:
    """None to draw them; ValueError if only some episodes have any."""
    given = [plan.conditions for plan in plans if plan.conditions is not None]
    if given and len(given) < len(plans):
        raise ValueError("Either all planned episodes have conditions, or none.")
    return given or None


def _tell_of_unstable(seats: Iterable[_Seat]) -> None:
    for seat in seats:
        _logger.warning(
            "The physics of %s episode %d failed at step %d: the car jumped, flew or became NaN. "
            "It counts as off track.",
            seat.plan.phase,
            seat.plan.number,
            len(seat.episode.rows) + 1,
        )


def _groups(driving: Iterable[_Seat]) -> Iterable[list[_Seat]]:
    """Cars that choose together: those of one racer."""
    groups: dict[int, list[_Seat]] = defaultdict(list)
    for seat in driving:
        groups[seat.plan.racer].append(seat)
    return groups.values()


def _record(
    group: Sequence[_Seat],
    frames: NDArray[np.uint8],
    seen: Observation,
    decision: Decision,
    requests: tuple[NDArray[np.float64], NDArray[np.float64]],
    result: StepResult,
) -> None:
    continuous = group[0].racer.model.spec.continuous
    actions = decision.actions if continuous else decision.actions.tolist()
    scans, states = seen.scan.numpy(), seen.state.numpy()
    for row, seat in enumerate(group):
        steering_deg, speed_mps = (values.item(seat.car) for values in requests)
        label = f"[{steering_deg} {speed_mps}]" if continuous else str(actions[row])
        seat.record(result, (steering_deg, speed_mps), label)
        if seat.plan.phase == "training":
            log_prob, value = decision.log_probs.item(row), decision.values.item(row)
            known = not result.failed.item(seat.car)
            seen_here = frames[row], scans[row], states[row]
            seat.episode.samples.append((*seen_here, actions[row], log_prob, value, known))


# Writes a line into the log of a worker for each episode that has ended.


_episode_logger = log.get_logger(__name__)


def log_training(episode: Episode, iteration: int, worker: int) -> None:
    _log(
        "episode",
        f"Episode {episode.number} of iteration {iteration}",
        episode,
        iteration=iteration,
        worker=worker,
    )


def log_evaluation(episode: Episode, checkpoint: int, worker: int) -> None:
    _log(
        "evaluation",
        f"Evaluation episode {episode.number} of checkpoint {checkpoint}",
        episode,
        checkpoint=checkpoint,
        worker=worker,
    )


def log_trial(episode: Episode, model: str) -> None:
    record = TrialMetrics.of(episode)
    penalty_s = (record.penalty_in_milliseconds or 0.0) / 1000.0
    _log(
        "trial",
        f"Trial {episode.number + 1} of {model}",
        episode,
        time=lap_time(episode.duration_s, penalty_s, record.reset_count),
        model=model,
        resets=record.reset_count,
        penalty_s=penalty_s,
    )


def _log(kind: str, what: str, episode: Episode, *, time: str = "", **facts: Any) -> None:
    status = STATUS_LABELS.get(episode.status, episode.status)
    log.event(
        _episode_logger,
        kind,
        f"{what}: {status.lower()} at {episode.progress:.1f} % after {episode.steps} steps "
        f"({time or f'{episode.duration_s:.3f} s'}), reward {episode.reward:.2f}.",
        **facts,
        episode=episode.number,
        status=episode.status,
        progress=round(float(episode.progress), 4),
        steps=episode.steps,
        duration_s=round(float(episode.duration_s), 4),
        reward=round(float(episode.reward), 4),
        start_waypoint=int(episode.rows[0].closest_waypoint),
        end_waypoint=int(episode.rows[-1].closest_waypoint),
        crashes=int(episode.rows[-1].crashes),
    )

"""Episodes of many cars: their rules, how they end, and what a violation costs."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.car.car import CONTROL_HZ
from drsim.jit import kernel

IMMOBILIZED_M = 0.0003
"""A car that moves no further in a step stands still. Source: the reference simulator."""

UNFINISHED = 99.99
"""Most percent that a car can have after it was put back."""


class Status(IntEnum):
    """What a step was. The names in lower case are the words of traces and metrics."""

    IN_PROGRESS = 0
    PREPARE = 1
    PAUSE = 2
    PARK = 3
    LAP_COMPLETE = 4
    CRASHED = 5
    OFF_TRACK = 6
    IMMOBILIZED = 7
    TIME_UP = 8
    REVERSED = 9
    DISCARDED = 10

    @property
    def label(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class EpisodeRules:
    """When an episode ends. The defaults are those of training: at the first violation.

    Attributes:
        laps: More than one makes a continuous race.
        max_resets: Violations forgiven: the car is put back on the track, and waits.
        off_track_penalty_s: Wait after leaving the track, seconds.
        patience_steps: Consecutive steps without motion, or with falling progress, until a
            violation.
        max_steps: Then an episode is cut off.
        max_lap_steps: Then a lap's time is up, waiting included; 0 for no limit.
    """

    laps: int = 1
    max_resets: int = 0
    off_track_penalty_s: float = 0.0
    collision_penalty_s: float = 0.0
    reversed_penalty_s: float = 0.0
    immobilized_penalty_s: float = 0.0
    patience_steps: int = 15
    max_steps: int = 10_000
    max_lap_steps: int = 0

    @classmethod
    def evaluation(
        cls,
        *,
        laps: int = 1,
        max_resets: int = 0,
        off_track_penalty_s: float = 2.0,
        collision_penalty_s: float = 5.0,
        max_steps: int = 10_000,
        max_lap_steps: int = 0,
    ) -> Self:
        """Driving backwards costs the off-track penalty."""
        return cls(
            laps=laps,
            max_resets=max_resets,
            off_track_penalty_s=off_track_penalty_s,
            collision_penalty_s=collision_penalty_s,
            reversed_penalty_s=off_track_penalty_s,
            max_steps=max_steps,
            max_lap_steps=max_lap_steps,
        )

    def penalty_s(self, status: Status) -> float:
        """How long a car waits after such a violation, seconds."""
        return {
            Status.CRASHED: self.collision_penalty_s,
            Status.OFF_TRACK: self.off_track_penalty_s,
            Status.IMMOBILIZED: self.immobilized_penalty_s,
            Status.REVERSED: self.reversed_penalty_s,
        }.get(status, 0.0)


class Observed(NamedTuple):
    """What a step showed of each car. Arrays of shape (n,).

    Attributes:
        fraction: Where the point ahead of the car is on the lap, 0 .. 1.
        off_track: No wheel is on the track.
    """

    driven: Bools
    fraction: Floats
    moved_m: Floats
    off_track: Bools
    crashed: Bools


class Verdict(NamedTuple):
    """What one step led to. Arrays of shape (n,), meaningful where the car was driven.

    `status` are `Status` numbers; `put_back` means that the violation is forgiven.
    """

    status: Ints
    terminated: Bools
    truncated: Bools
    put_back: Bools


class EpisodeState(NamedTuple):
    """The running episodes of n cars. Arrays of shape (n,), changed in place.

    Attributes:
        steps: The first one included.
        progress: Percent of the lap; exactly 100 in the step that completes it.
        previous_progress: 0 after a completed lap.
        start_fraction: 0 .. 1 along the centre line.
        resets: Violations forgiven.
        pause_steps: Steps still to wait.
        lap_steps: Of the current lap, waiting included.
        still_steps: Consecutive driven ones.
        backward_steps: Consecutive driven ones with falling progress.
        over: Ended, or none has begun.
    """

    steps: Ints
    progress: Floats
    previous_progress: Floats
    start_fraction: Floats
    laps: Ints
    resets: Ints
    crashes: Ints
    pause_steps: Ints
    lap_steps: Ints
    still_steps: Ints
    backward_steps: Ints
    over: Bools


class Episodes:
    def __init__(self, num_cars: int, rules: EpisodeRules) -> None:
        self.rules = rules

        def count() -> Ints:
            return np.zeros(num_cars, np.int64)

        self.state = EpisodeState(
            steps=count(),
            progress=np.zeros(num_cars),
            previous_progress=np.zeros(num_cars),
            start_fraction=np.zeros(num_cars),
            laps=count(),
            resets=count(),
            crashes=count(),
            pause_steps=count(),
            lap_steps=count(),
            still_steps=count(),
            backward_steps=count(),
            over=np.ones(num_cars, np.bool_),
        )
        self._parts = tuple(self.state)
        pauses = [round(rules.penalty_s(status) * CONTROL_HZ) for status in Status]
        self._limits = (
            rules.laps,
            rules.max_resets,
            rules.patience_steps,
            rules.max_steps,
            rules.max_lap_steps,
            np.array(pauses, np.int64),
        )

    def begin(self, cars: Ints, start_fraction: Floats, fraction: Floats) -> None:
        """Start episodes with their `prepare` step.

        A car's origin is at `start_fraction` of the lap, 0 .. 1, the point ahead of it at
        `fraction`.
        """
        state = self.state
        for values in state:
            values[cars] = 0
        state.steps[cars] = 1
        state.start_fraction[cars] = start_fraction
        state.progress[cars] = advance_progress(np.zeros(len(cars)), fraction, start_fraction)

    def wait(self, cars: Bools) -> None:
        self.state.pause_steps[cars] -= 1
        self.state.steps[cars] += 1
        self.state.lap_steps[cars] += 1

    def put_back(self, cars: Ints, fraction: Floats) -> None:
        start, before = self.state.start_fraction[cars], self.state.progress[cars]
        # A car can be put back with its nose across the finish line. It has not driven there: the
        # lap counts with the next step that it drives.
        progress = np.minimum(advance_progress(before, fraction, start), UNFINISHED)
        self.state.progress[cars] = progress

    def discard(self, cars: Bools, verdict: Verdict) -> None:
        """End episodes that the reward function declared broken."""
        verdict.status[cars] = Status.DISCARDED
        verdict.terminated[cars] = verdict.put_back[cars] = False
        verdict.truncated[cars] = True
        self.state.pause_steps[cars] = 0
        self.state.over[cars] = True

    def judge(self, observed: Observed) -> Verdict:
        """Count one driven step and decide what it led to."""
        return Verdict(*_judge(tuple(observed), self._limits, self._parts))


_IN_PROGRESS, _LAP_COMPLETE, _CRASHED, _OFF_TRACK, _IMMOBILIZED, _TIME_UP, _REVERSED = (
    int(status)
    for status in (
        Status.IN_PROGRESS,
        Status.LAP_COMPLETE,
        Status.CRASHED,
        Status.OFF_TRACK,
        Status.IMMOBILIZED,
        Status.TIME_UP,
        Status.REVERSED,
    )
)
"""The compiler knows no enumerations."""


@kernel
def advance_progress(previous: Floats, fraction: Floats, start_fraction: Floats) -> Floats:
    """Progress after a step, in percent of a lap counted from the start of the episode.

    Crossing the finish line forwards ends at exactly 100, backing over the start line gives
    negative values, and after a lap it begins again from 0. Source: the reference simulator's
    rules, in their order.

    `previous` is 0 at the start and after a lap; `fraction` is 0 .. 1 from waypoint 0. Shape (n,).
    """
    progress = 100.0 * (fraction - start_fraction)
    for car in range(len(progress)):
        if progress[car] <= 0:
            progress[car] += 100
        if previous[car] > progress[car] + 50:
            progress[car] += 100
        if progress[car] > previous[car] + 50:
            progress[car] -= 100
        progress[car] = min(progress[car], 100.0)
    return progress


@kernel
def _judge(
    observed: tuple[Any, ...], limits: tuple[Any, ...], state: tuple[Any, ...]
) -> tuple[Ints, Bools, Bools, Bools]:
    """Count one step of each driven car in `state`; returns the parts of a `Verdict`.

    Only consecutive driven steps count against a car's patience.
    """
    driven, fraction, moved_m, off_track, crashed = observed
    laps, max_resets, patience_steps, max_steps, max_lap_steps, pause_steps = limits
    s, count = EpisodeState(*state), len(driven)
    # After a completed lap progress begins again from 0.
    before = np.where(driven & (s.progress >= 100.0), 0.0, s.progress)
    now = advance_progress(before, fraction, s.start_fraction)
    status = np.full(count, _IN_PROGRESS)
    terminated, truncated = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    put_back = np.zeros(count, np.bool_)
    for car in range(count):
        if not driven[car]:
            s.still_steps[car] = s.backward_steps[car] = 0
            continue
        s.steps[car] += 1
        s.lap_steps[car] = 1 if s.progress[car] >= 100.0 else s.lap_steps[car] + 1
        s.previous_progress[car], s.progress[car] = before[car], now[car]
        still = moved_m[car] <= IMMOBILIZED_M
        s.still_steps[car] = s.still_steps[car] + 1 if still else 0
        s.backward_steps[car] = s.backward_steps[car] + 1 if now[car] < before[car] else 0

        lap_done = now[car] >= 100.0
        s.laps[car] += lap_done
        finished = lap_done and s.laps[car] >= laps
        # The first that applies wins, in the reference's order.
        if finished:
            status[car] = _LAP_COMPLETE
        elif lap_done:
            status[car] = _IN_PROGRESS
        elif crashed[car]:
            status[car] = _CRASHED
        elif off_track[car]:
            status[car] = _OFF_TRACK
        elif s.still_steps[car] >= patience_steps:
            status[car] = _IMMOBILIZED
        elif s.backward_steps[car] >= patience_steps:
            status[car] = _REVERSED

        violated = status[car] != _IN_PROGRESS and not finished
        s.crashes[car] += status[car] == _CRASHED
        terminated[car] = finished or (violated and s.resets[car] >= max_resets)
        over = s.steps[car] >= max_steps
        time_up = max_lap_steps > 0 and not lap_done and (over or s.lap_steps[car] >= max_lap_steps)
        truncated[car] = not terminated[car] and (time_up or over)
        s.over[car] |= terminated[car] or truncated[car]
        if truncated[car] and time_up:
            status[car] = _TIME_UP
        elif truncated[car] and not lap_done:
            # Traces have no word for a step limit; readers count these as cars that got nowhere.
            status[car] = _IMMOBILIZED
        elif violated and not terminated[car]:
            put_back[car] = True
            s.resets[car] += 1
            s.pause_steps[car] = pause_steps[status[car]]
            s.still_steps[car] = s.backward_steps[car] = 0
    return status, terminated, truncated, put_back


@dataclass(frozen=True)
class StepResult:
    """One row of the trace for every car; arrays of shape (n,), never changed afterwards.

    All values are those after the motion of the step.

    Attributes:
        driven: The action moved the car; false while it waits or is parked, and in an episode's
            first step. Only driven steps can be learned from.
        reward: 0 where the car was not driven.
        failed: The reward function failed, and this reward is in its place.
        reward_time_s: Wall time of the call; 0 where the car was not driven.
        terminated: The episode ended by its rules.
        truncated: It was cut off by the step limit or as `Status.DISCARDED`.
        status: Numbers of `Status`.
        progress: Percent of the lap, exactly 100 in the step that completes it.
        x: Of the point 0.14 m ahead of the car's origin, metres.
        y: Of that point, metres.
        yaw_deg: Heading, -180 .. 180.
        all_wheels_on_track: All wheel centres are strictly inside the borders.
        steps: 1 for the first.
        sim_time_s: Clock of the car, which never runs backwards.
        pause_s: Still to wait.
        lap_time_s: Since the lap began, waiting included; in its last step, the lap time.
        resets: Violations forgiven.
    """

    driven: Bools
    reward: Floats
    failed: Bools
    reward_time_s: Floats
    terminated: Bools
    truncated: Bools
    status: Ints
    progress: Floats
    x: Floats
    y: Floats
    yaw_deg: Floats
    all_wheels_on_track: Bools
    closest_waypoint: Ints
    from_center_m: Floats
    steps: Ints
    sim_time_s: Floats
    pause_s: Floats
    laps: Ints
    lap_time_s: Floats
    resets: Ints
    crashes: Ints

    @cached_property
    def done(self) -> Bools:
        """The episode ended, either way."""
        return self.terminated | self.truncated

"""Episodes: their rules, how they end, and what a violation costs, for many cars at once."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drsim.car.car import CONTROL_HZ
from drsim.episode.progress import advance_progress
from drsim.jit import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

IMMOBILIZED_M = 0.0003
"""A car that moves no further than this in a step stands still. Source: the reference simulator."""


UNFINISHED = 99.99
"""Most progress, in percent, that being put back can give."""


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

    @property
    def label(self) -> str:
        """The word in traces, for example `off_track`."""
        return self.name.lower()


@dataclass(frozen=True)
class EpisodeRules:
    """When an episode ends. The defaults are those of training: at the first violation.

    Attributes:
        laps: Laps in one episode; more than one makes a continuous race.
        max_resets: Violations forgiven in one episode: the car is put back on the track, and waits.
        off_track_penalty_s: Wait after leaving the track, seconds.
        collision_penalty_s: Wait after a crash, seconds.
        reversed_penalty_s: Wait after driving backwards, seconds.
        immobilized_penalty_s: Wait after standing still, seconds.
        patience_steps: Consecutive steps without motion, or with falling progress, that make a
            violation.
        max_steps: Steps after which an episode is cut off, the first included.
    """

    laps: int = 1
    max_resets: int = 0
    off_track_penalty_s: float = 0.0
    collision_penalty_s: float = 0.0
    reversed_penalty_s: float = 0.0
    immobilized_penalty_s: float = 0.0
    patience_steps: int = 15
    max_steps: int = 10_000

    @classmethod
    def evaluation(
        cls,
        *,
        laps: int = 1,
        max_resets: int = 0,
        off_track_penalty_s: float = 2.0,
        collision_penalty_s: float = 5.0,
        max_steps: int = 10_000,
    ) -> Self:
        """Rules of a stand-alone evaluation; driving backwards costs the off-track penalty."""
        return cls(
            laps=laps,
            max_resets=max_resets,
            off_track_penalty_s=off_track_penalty_s,
            collision_penalty_s=collision_penalty_s,
            reversed_penalty_s=off_track_penalty_s,
            max_steps=max_steps,
        )

    def penalty_s(self, status: Status) -> float:
        """How long a car waits after a violation of this kind, in seconds."""
        return {
            Status.CRASHED: self.collision_penalty_s,
            Status.OFF_TRACK: self.off_track_penalty_s,
            Status.IMMOBILIZED: self.immobilized_penalty_s,
            Status.REVERSED: self.reversed_penalty_s,
        }.get(status, 0.0)


@dataclass(frozen=True)
class Verdict:
    """What one step led to; arrays over cars, meaningful where the car was driven.

    Attributes:
        status: Status numbers. Shape (n,).
        terminated: The episode is over by its rules. Shape (n,).
        truncated: The episode was cut off by the step limit. Shape (n,).
        put_back: The violation is forgiven: the car goes back on the track. Shape (n,).
        lap_done: A lap was completed in this step. Shape (n,).
    """

    status: Ints
    terminated: Bools
    truncated: Bools
    put_back: Bools
    lap_done: Bools


class Episodes:
    """The running episodes of n cars: counters, progress and pauses.

    Attributes:
        steps: Steps of the episode so far, the first one included. Shape (n,).
        progress: Percent of the current lap; exactly 100 in the step that completes it. Shape (n,).
        previous_progress: That of the step before; 0 after a completed lap. Shape (n,).
        start_fraction: Where the episode started, 0 .. 1 along the centre line. Shape (n,).
        laps: Laps completed in this episode. Shape (n,).
        resets: Violations forgiven in this episode. Shape (n,).
        crashes: Crashes in this episode. Shape (n,).
        pause_steps: Steps the car still has to wait. Shape (n,).
        lap_steps: Steps since the current lap began, waiting included. Shape (n,).
        over: The episode has ended, or none has begun. Shape (n,).
    """

    def __init__(self, num_cars: int, rules: EpisodeRules) -> None:
        """Prepare n cars without an episode."""
        self.rules = rules
        self.steps: Ints = np.zeros(num_cars, np.int64)
        self.progress: Floats = np.zeros(num_cars)
        self.previous_progress: Floats = np.zeros(num_cars)
        self.start_fraction: Floats = np.zeros(num_cars)
        self.laps: Ints = np.zeros(num_cars, np.int64)
        self.resets: Ints = np.zeros(num_cars, np.int64)
        self.crashes: Ints = np.zeros(num_cars, np.int64)
        self.pause_steps: Ints = np.zeros(num_cars, np.int64)
        self.lap_steps: Ints = np.zeros(num_cars, np.int64)
        self.over: Bools = np.ones(num_cars, np.bool_)
        self._pause_steps = np.array(
            [round(rules.penalty_s(status) * CONTROL_HZ) for status in Status], np.int64
        )
        self._still_steps: Ints = np.zeros(num_cars, np.int64)
        self._backward_steps: Ints = np.zeros(num_cars, np.int64)

    def begin(self, cars: Ints, start_fraction: Floats, fraction: Floats) -> None:
        """Start episodes with their `prepare` step.

        Args:
            cars: Which cars. Shape (k,).
            start_fraction: Where the car origin stands on the lap, 0 .. 1. Shape (k,).
            fraction: Where the point ahead of the car stands, 0 .. 1. Shape (k,).
        """
        for counter in (self.laps, self.resets, self.crashes, self.pause_steps, self.lap_steps):
            counter[cars] = 0
        self._restart_patience(cars)
        self.steps[cars] = 1
        self.over[cars] = False
        self.start_fraction[cars] = start_fraction
        self.previous_progress[cars] = 0.0
        self.progress[cars] = advance_progress(np.zeros(len(cars)), fraction, start_fraction)

    def wait(self, cars: Bools) -> None:
        """Count one step of waiting for the cars that are paused. Shape (n,)."""
        self.pause_steps[cars] -= 1
        self.steps[cars] += 1
        self.lap_steps[cars] += 1

    def put_back(self, cars: Ints, fraction: Floats) -> None:
        """Take note of where cars stand after a forgiven violation.

        Args:
            cars: Which cars. Shape (k,).
            fraction: Where the point ahead of each is now, 0 .. 1 of the lap. Shape (k,).
        """
        start, before = self.start_fraction[cars], self.progress[cars]
        # A car can be put back with its nose across the finish line. It has not driven there: the
        # lap counts with the next step that it drives.
        self.progress[cars] = np.minimum(advance_progress(before, fraction, start), UNFINISHED)

    def judge(
        self,
        driven: Bools,
        fraction: Floats,
        moved_m: Floats,
        off_track: Bools,
        crashed: Bools,
    ) -> Verdict:
        """Count one driven step and decide what it led to.

        Args:
            driven: Cars that were driven in this step. Shape (n,).
            fraction: Where the point ahead of each car is on the lap, 0 .. 1. Shape (n,).
            moved_m: How far each car's origin moved in the step, metres. Shape (n,).
            off_track: No wheel of the car is on the track. Shape (n,).
            crashed: The car has driven into something. Shape (n,).

        Returns:
            The outcome; cars that are over or put back are so from now on.
        """
        rules = self.rules
        fresh = driven & (self.progress >= 100.0)
        before = np.where(fresh, 0.0, self.progress)
        now = advance_progress(before, fraction, self.start_fraction)
        status = np.empty(len(driven), np.int64)
        terminated, truncated, put_back, lap_done = np.empty((4, len(driven)), np.bool_)
        _judge(
            driven,
            before,
            now,
            moved_m,
            off_track,
            crashed,
            rules.laps,
            rules.max_resets,
            rules.patience_steps,
            rules.max_steps,
            self._pause_steps,
            self.steps,
            self.lap_steps,
            self.previous_progress,
            self.progress,
            self.laps,
            self.resets,
            self.crashes,
            self.pause_steps,
            self.over,
            self._still_steps,
            self._backward_steps,
            status,
            terminated,
            truncated,
            put_back,
            lap_done,
        )
        return Verdict(status, terminated, truncated, put_back, lap_done)

    def _restart_patience(self, cars: Ints) -> None:
        self._still_steps[cars] = 0
        self._backward_steps[cars] = 0


_IN_PROGRESS, _LAP_COMPLETE, _CRASHED, _OFF_TRACK, _IMMOBILIZED, _REVERSED = (
    int(status)
    for status in (
        Status.IN_PROGRESS,
        Status.LAP_COMPLETE,
        Status.CRASHED,
        Status.OFF_TRACK,
        Status.IMMOBILIZED,
        Status.REVERSED,
    )
)
"""The compiler knows integers, no enumerations."""


@kernel
def _judge(
    driven: Bools,
    before: Floats,
    now: Floats,
    moved_m: Floats,
    off_track: Bools,
    crashed: Bools,
    laps_wanted: int,
    max_resets: int,
    patience_steps: int,
    max_steps: int,
    penalty_steps: Ints,
    steps: Ints,
    lap_steps: Ints,
    previous_progress: Floats,
    progress: Floats,
    laps: Ints,
    resets: Ints,
    crashes: Ints,
    pause_steps: Ints,
    over: Bools,
    still_steps: Ints,
    backward_steps: Ints,
    status: Ints,
    terminated: Bools,
    truncated: Bools,
    put_back: Bools,
    lap_done: Bools,
) -> None:
    """Count one step of each driven car and judge it; from `steps` on, all arrays are written.

    A car that is not driven has patience again: only consecutive driven steps count.
    """
    for car in range(len(driven)):
        status[car] = _IN_PROGRESS
        terminated[car] = truncated[car] = put_back[car] = lap_done[car] = False
        if not driven[car]:
            still_steps[car] = backward_steps[car] = 0
            continue
        steps[car] += 1
        lap_steps[car] = 1 if progress[car] >= 100.0 else lap_steps[car] + 1
        previous_progress[car], progress[car] = before[car], now[car]
        still_steps[car] = still_steps[car] + 1 if moved_m[car] <= IMMOBILIZED_M else 0
        backward_steps[car] = backward_steps[car] + 1 if now[car] < before[car] else 0

        lap_done[car] = now[car] >= 100.0
        laps[car] += lap_done[car]
        finished = lap_done[car] and laps[car] >= laps_wanted
        # In the reference's order of precedence.
        if finished:
            status[car] = _LAP_COMPLETE
        elif lap_done[car]:
            status[car] = _IN_PROGRESS
        elif crashed[car]:
            status[car] = _CRASHED
        elif off_track[car]:
            status[car] = _OFF_TRACK
        elif still_steps[car] >= patience_steps:
            status[car] = _IMMOBILIZED
        elif backward_steps[car] >= patience_steps:
            status[car] = _REVERSED

        violated = status[car] != _IN_PROGRESS and not finished
        crashes[car] += status[car] == _CRASHED
        terminated[car] = finished or (violated and resets[car] >= max_resets)
        truncated[car] = not terminated[car] and steps[car] >= max_steps
        over[car] |= terminated[car] or truncated[car]
        if truncated[car]:
            # Traces know no word for a step limit; readers count these as cars that got nowhere.
            status[car] = _IMMOBILIZED
        elif violated and not terminated[car]:
            put_back[car] = True
            resets[car] += 1
            pause_steps[car] = penalty_steps[status[car]]
            still_steps[car] = backward_steps[car] = 0

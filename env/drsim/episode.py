"""Episodes: their rules, how they end, and what a violation costs, for many cars at once."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drsim.car import CONTROL_HZ
from drsim.progress import advance_progress

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
        self.pause_steps: Ints = np.zeros(num_cars, np.int64)
        self.lap_steps: Ints = np.zeros(num_cars, np.int64)
        self.over: Bools = np.ones(num_cars, np.bool_)
        self._still_steps: Ints = np.zeros(num_cars, np.int64)
        self._backward_steps: Ints = np.zeros(num_cars, np.int64)

    def begin(self, cars: Ints, start_fraction: Floats, fraction: Floats) -> None:
        """Start episodes with their `prepare` step.

        Args:
            cars: Which cars. Shape (k,).
            start_fraction: Where the car origin stands on the lap, 0 .. 1. Shape (k,).
            fraction: Where the point ahead of the car stands, 0 .. 1. Shape (k,).
        """
        for counter in (self.laps, self.resets, self.pause_steps, self.lap_steps):
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

    def judge(self, driven: Bools, fraction: Floats, moved_m: Floats, off_track: Bools) -> Verdict:
        """Count one driven step and decide what it led to.

        Args:
            driven: Cars that were driven in this step. Shape (n,).
            fraction: Where the point ahead of each car is on the lap, 0 .. 1. Shape (n,).
            moved_m: How far each car's origin moved in the step, metres. Shape (n,).
            off_track: No wheel of the car is on the track. Shape (n,).

        Returns:
            The outcome; cars that are over or put back are so from now on.
        """
        rules = self.rules
        self._count(driven, fraction, moved_m)
        lap_done = driven & (self.progress >= 100.0)
        self.laps[lap_done] += 1

        # In the reference's order of precedence: a later line overrides an earlier one.
        status = np.full(len(driven), Status.IN_PROGRESS, np.int64)
        status[self._backward_steps >= rules.patience_steps] = Status.REVERSED
        status[self._still_steps >= rules.patience_steps] = Status.IMMOBILIZED
        status[off_track] = Status.OFF_TRACK
        finished = lap_done & (self.laps >= rules.laps)
        status[lap_done] = Status.IN_PROGRESS
        status[finished] = Status.LAP_COMPLETE

        violated = driven & (status != Status.IN_PROGRESS) & ~finished
        put_back = violated & (self.resets < rules.max_resets)
        terminated = finished | (violated & ~put_back)
        truncated = driven & ~terminated & (self.steps >= rules.max_steps)
        # Traces know no word for a step limit; readers count these as cars that got nowhere.
        status[truncated] = Status.IMMOBILIZED
        put_back &= ~truncated
        self.resets[put_back] += 1
        self._start_pauses(put_back, status)
        self.over |= terminated | truncated
        return Verdict(status, terminated, truncated, put_back, lap_done)

    def _count(self, driven: Bools, fraction: Floats, moved_m: Floats) -> None:
        self.steps[driven] += 1
        self.lap_steps[driven] += 1
        finished_before = driven & (self.progress >= 100.0)
        self.lap_steps[finished_before] = 1
        before = np.where(finished_before, 0.0, self.progress)
        now = advance_progress(before, fraction, self.start_fraction)
        self.previous_progress = np.where(driven, before, self.previous_progress)
        self.progress = np.where(driven, now, self.progress)
        self._still_steps = np.where(driven & (moved_m <= IMMOBILIZED_M), self._still_steps + 1, 0)
        self._backward_steps = np.where(driven & (now < before), self._backward_steps + 1, 0)

    def _start_pauses(self, put_back: Bools, status: Ints) -> None:
        for car in np.flatnonzero(put_back):
            penalty_s = self.rules.penalty_s(Status(int(status[car])))
            self.pause_steps[car] = round(penalty_s * CONTROL_HZ)
        self._restart_patience(np.flatnonzero(put_back))

    def _restart_patience(self, cars: Ints) -> None:
        self._still_steps[cars] = 0
        self._backward_steps[cars] = 0

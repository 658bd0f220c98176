"""The calls that reward functions are tried with."""

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drcli.base.problems import Problem
from drcli.config.run_config import RaceConfig
from drcli.modelfiles.custom_files import InputFile
from drcli.rewards.drivers import FAST, STEADY, ScriptedDriver
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import read_source
from drcli.rewards.sandbox.run_sandbox import Sandbox
from drcli.rewards.sandbox.sandbox_records import CallIndex, SandboxRequest, SandboxResult
from drcli.rewards.scripted_drive import Drive, Trip
from drcli.rewards.track_grid import Grid, track_grid
from drsim.episode.reward import RewardParams

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """All calls."""

    drive: Drive
    grid: Grid

    @staticmethod
    def of(drive: Drive) -> "Course":
        return Course(drive, track_grid(drive))

    @property
    def sequences(self) -> list[list[dict[str, Any]]]:
        """The drivers' first, then the grid."""
        return [*(trip.calls for trip in self.drive.trips), self.grid.calls]

    def describe(self, place: CallIndex) -> str:
        trips = self.drive.trips
        if place.sequence == len(trips):
            return f"a car placed on the track, {position(self.grid.calls[place.index])}"
        trip = trips[place.sequence]
        step = f"{trip.driver.name} driver, step {place.index + 2}"
        return f"{step}, {position(trip.calls[place.index])}"


@dataclass(frozen=True)
class TriedReward:
    """One reward function on a course."""

    name: str
    course: Course
    result: SandboxResult
    text: str
    problems: list[Problem]

    def values(self, driver: ScriptedDriver) -> list[float | None]:
        return self.result.values[self.course.drive.trips.index(self.trip(driver))]

    def trip(self, driver: ScriptedDriver) -> Trip:
        return self.course.drive.trip(driver)

    def total(self, driver: ScriptedDriver) -> float | None:
        """None if a call failed or was not made."""
        values = self.values(driver)
        paid = [value for value in values if value is not None]
        return sum(paid) if len(paid) == len(values) else None

    def mean(self, driver: ScriptedDriver) -> float | None:
        total = self.total(driver)
        return None if total is None else total / len(self.values(driver))

    @property
    def prefers_fast(self) -> bool | None:
        """None without both laps."""
        slow, fast = self.total(STEADY), self.total(FAST)
        whole = self.trip(STEADY).whole and self.trip(FAST).whole
        return None if slow is None or fast is None or not whole else fast > slow

    @property
    def drive_values(self) -> Floats:
        """Of all drivers; NaN if a call failed. Shape (n,)."""
        trips = self.result.values[: len(self.course.drive.trips)]
        return as_array([value for trip in trips for value in trip])

    @property
    def grid_values(self) -> Floats:
        """NaN if a call failed. Shape (offsets, n)."""
        values = self.result.values[len(self.course.drive.trips)]
        return as_array(values).reshape(self.course.grid.off.shape)

    @property
    def samples(self) -> list[float | None]:
        return next(iter(self.result.values[len(self.course.sequences) :]), [])

    def warning(self, rule: str, message: str, remedy: str, line: int | None = None) -> Problem:
        return Problem(rule, "warning", self.name, line, message, remedy)


def as_array(values: list[float | None]) -> Floats:
    """NaN for None. Shape (n,)."""
    return np.array([math.nan if value is None else value for value in values])


def scaled(values: Floats, over: Floats) -> Floats:
    """So that the least and greatest of `over` become 0 and 1."""
    known = over[~np.isnan(over)]
    low, high = np.percentile(known, [1, 99]).tolist() if len(known) else (0.0, 0.0)
    if high <= low:
        return np.where(np.isnan(values), np.nan, 0.5)
    return np.clip((values - low) / (high - low), 0.0, 1.0)


def position(call: RewardParams) -> str:
    side = "left" if call["is_left_of_center"] else "right"
    return (
        f"{call['progress']:.1f} % of the lap, {call['distance_from_center']:.2f} m {side} of the "
        "centre line"
    )


def try_rewards(
    files: Sequence[InputFile],
    course: Course,
    directory: Path,
    races: list[RaceConfig] | None = None,
    tolerated: float = 0.0,
    given_up: Event | None = None,
) -> list[TriedReward]:
    """Call reward functions at the same time, first on samples of `races`.

    After `given_up`, its values are of no use.
    """
    ways = course.drive.waypoints()
    waypoints = [[list(point) for point in ways[way]] for way in (False, True)]
    repeated = len(course.drive.trips)
    tried = []
    with ExitStack() as stack:
        running = []
        for file in files:
            source, wrong = read_source(file)
            request = SandboxRequest(file.origin, course.sequences, waypoints, repeated, races)
            sandbox = Sandbox(request, file.data, directory) if source is not None else None
            running.append((file.origin, source, wrong, sandbox and stack.enter_context(sandbox)))
        for name, source, problems, sandbox in running:
            result = SandboxResult(values=[[None] * len(calls) for calls in course.sequences])
            if source is not None and sandbox is not None:
                result = sandbox.result(given_up)
                problems = problems_of(source, result, directory, tolerated)
            text = "" if source is None else source.text
            tried.append(TriedReward(name, course, result, text, problems))
    return tried

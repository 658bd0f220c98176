"""Calls reward functions along a course."""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import Problem, ProblemsError
from drcli.config.run_config import DriveConfig
from drcli.model.files.custom_files import InputFile
from drcli.rewards.course import FAST, STEADY, Course, ScriptedDriver, Trip, position
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import read_source
from drcli.rewards.sandbox.run_sandbox import CallIndex, Sandbox, SandboxRequest, SandboxResult

Floats = NDArray[np.float64]

_QUICKER = 0.9


@dataclass(frozen=True)
class TriedReward:
    """One reward function on a course; it may read the parameters `reads`."""

    name: str
    course: Course
    result: SandboxResult
    reads: frozenset[str]
    problems: list[Problem]

    def values(self, driver: ScriptedDriver) -> list[float | None]:
        return self.result.values[self.course.trips.index(self.trip(driver))]

    def trip(self, driver: ScriptedDriver) -> Trip:
        return self.course.trip(driver)

    def total(self, driver: ScriptedDriver) -> float | None:
        """None if a call failed or was not made."""
        values = self.values(driver)
        paid = [value for value in values if value is not None]
        return sum(paid) if len(paid) == len(values) else None

    def mean(self, driver: ScriptedDriver) -> float | None:
        total = self.total(driver)
        return None if total is None else total / len(self.values(driver))

    def discounted(self, driver: ScriptedDriver, discount: float) -> float:
        """Sum as seen from the first step; NaN if a call failed."""
        values = as_array(self.values(driver))
        return float(values @ discount ** np.arange(len(values)))

    def describe(self, place: CallIndex) -> str:
        if place.sequence > len(self.course.trips):  # after a hang there the drive is not made
            return "one of the calls before the drive"
        if place.sequence == len(self.course.trips):
            return f"a car placed on the track, {position(self.course.places[place.index])}"
        trip = self.course.trips[place.sequence]
        step = f"{trip.driver.name} driver, step {place.index + 2}"
        return f"{step}, {position(trip.calls[place.index])}"

    @property
    def prefers_fast(self) -> bool | None:
        """None without both laps on the road, or if the model's actions make them alike."""
        slow, fast = self.total(STEADY), self.total(FAST)
        steady, quick = self.trip(STEADY), self.trip(FAST)
        whole = steady.on_the_road and quick.on_the_road
        alike = quick.seconds >= _QUICKER * steady.seconds
        return None if slow is None or fast is None or alike or not whole else fast > slow

    @property
    def drive_values(self) -> Floats:
        """Of all drivers; NaN if a call failed. Shape (n,)."""
        trips = self.result.values[: len(self.course.trips)]
        return as_array([value for trip in trips for value in trip])

    @property
    def grid_values(self) -> Floats:
        """NaN if a call failed. Shape (offsets, n)."""
        values = self.result.values[len(self.course.trips)]
        return as_array(values).reshape(np.shape(self.course.off))

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


SandboxOf = Callable[[SandboxRequest, bytes | None, Path], Sandbox]
"""Of a request, the text of a file, and the working folder."""


def request_of(course: Course | DriveConfig) -> SandboxRequest:
    """The calls of a course, of which the last sequence is its grid; those of a race are driven."""
    if not isinstance(course, Course):
        return SandboxRequest("", drive=course)
    return SandboxRequest("", course.sequences, course.waypoints, len(course.trips))


def try_rewards(
    files: Sequence[InputFile],
    course: Course | DriveConfig,
    directory: Path,
    *,
    races: list[DriveConfig] | None = None,
    tolerated: float = 0.0,
    given_up: Event | None = None,
    metadata: str = "",
    hyperparameters: str | None = None,
    sandbox_of: SandboxOf | None = None,
) -> list[TriedReward]:
    """Call reward functions at the same time, first on samples of `races`.

    The sandbox drives the course of a race. After `given_up`, its values are of no use.

    Raises:
        ProblemsError: The track is missing, or the race does not fit.
    """
    known = course if isinstance(course, Course) else None
    asked = replace(
        request_of(course), races=races, metadata=metadata, hyperparameters=hyperparameters
    )
    tried = []
    with ExitStack() as stack:
        running = []
        for file in files:
            source, wrong = read_source(file)
            sandbox = None
            if source is not None or known is None:
                request = replace(asked, name=file.origin)
                data = None if source is None else file.data
                sandbox = stack.enter_context((sandbox_of or Sandbox)(request, data, directory))
            running.append((file.origin, source, wrong, sandbox))
        for name, source, problems, sandbox in running:
            result = SandboxResult() if sandbox is None else sandbox.result(given_up)
            if source is not None:
                problems = problems_of(source, result, directory, tolerated)
            driven = sandbox.course if known is None and sandbox is not None else known
            if driven is None:
                raise ProblemsError([*result.problems, *problems])
            if source is None:
                nothing: list[list[float | None]] = [[None] * len(c) for c in driven.sequences]
                result = SandboxResult(values=nothing)
            words = frozenset[str]() if source is None else source.words
            tried.append(TriedReward(name, driven, result, words, problems))
    return tried

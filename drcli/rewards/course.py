"""All calls that reward functions are tried with, and what one function paid for them."""

import math
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.checks.sandbox.run_sandbox import Sandbox
from drcli.checks.sandbox.sandbox_records import REMEDIES, Place, SandboxRequest, SandboxResult
from drcli.rewards.drivers import FAST, STEADY, ScriptedDriver
from drcli.rewards.scripted_drive import Drive, Trip
from drcli.rewards.source import display_name
from drcli.rewards.track_grid import Grid, track_grid, unusual_states
from drsim.episode.reward import RewardParams

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """All calls that functions are tried with.

    Attributes:
        drive: What the drivers met.
        grid: Places on the road and beside it.
        unusual: Single states that the drivers do not get into, by name.
    """

    drive: Drive
    grid: Grid
    unusual: dict[str, RewardParams]

    @staticmethod
    def of(drive: Drive) -> "Course":
        """The course of a drive."""
        return Course(drive, track_grid(drive), unusual_states(drive, drive.trip(STEADY).calls))

    @property
    def sequences(self) -> list[list[dict[str, Any]]]:
        """The calls: the drivers' first, then the grid, then what is unusual."""
        trips = [trip.calls for trip in self.drive.trips]
        return [*trips, self.grid.calls, list(self.unusual.values())]

    @property
    def size(self) -> int:
        """How many calls there are."""
        return sum(map(len, self.sequences))

    def describe(self, place: Place) -> str:
        """A call in words."""
        trips = self.drive.trips
        if place.sequence > len(trips):
            return list(self.unusual)[place.index]
        if place.sequence == len(trips):
            return f"a car placed on the track, {position(self.grid.calls[place.index])}"
        trip = trips[place.sequence]
        step = f"{trip.driver.name} driver, step {place.index + 2}"
        return f"{step}, {position(trip.calls[place.index])}"


@dataclass(frozen=True)
class TriedReward:
    """One reward function on a course.

    Attributes:
        name: What its author calls the file.
        course: What it was tried with.
        result: What it did.
        file: The file.
        text: Its content.
    """

    name: str
    course: Course
    result: SandboxResult
    file: Path
    text: bytes

    def values(self, driver: ScriptedDriver) -> list[float | None]:
        """What it paid a driver at each step."""
        return self.result.values[self.course.drive.trips.index(self.trip(driver))]

    def trip(self, driver: ScriptedDriver) -> Trip:
        """What a driver did."""
        return self.course.drive.trip(driver)

    def total(self, driver: ScriptedDriver) -> float | None:
        """What it paid a driver altogether; None if a call failed or was not made."""
        values = self.values(driver)
        paid = [value for value in values if value is not None]
        return sum(paid) if len(paid) == len(values) else None

    def mean(self, driver: ScriptedDriver) -> float | None:
        """What it paid a driver for a step."""
        total = self.total(driver)
        return None if total is None else total / len(self.values(driver))

    @property
    def prefers_fast(self) -> bool | None:
        """Whether it pays a fast lap more than a slow one; None where a lap was not completed."""
        slow, fast = self.total(STEADY), self.total(FAST)
        whole = self.trip(STEADY).whole and self.trip(FAST).whole
        return None if slow is None or fast is None or not whole else fast > slow

    @property
    def drive_values(self) -> Floats:
        """What it paid all drivers, one after the other; NaN where a call failed. Shape (n,)."""
        trips = self.result.values[: len(self.course.drive.trips)]
        return as_array([value for trip in trips for value in trip])

    @property
    def grid_values(self) -> Floats:
        """What it paid for the places of the grid; NaN where a call failed. Shape (offsets, n)."""
        values = self.result.values[len(self.course.drive.trips)]
        return as_array(values).reshape(self.course.grid.off.shape)


def as_array(values: list[float | None]) -> Floats:
    """Rewards with NaN for None. Shape (n,)."""
    return np.array([math.nan if value is None else value for value in values])


def scaled(values: Floats, over: Floats) -> Floats:
    """Values from 0 to 1, where these are the least and the greatest of others."""
    known = over[~np.isnan(over)]
    low, high = np.percentile(known, [1, 99]).tolist() if len(known) else (0.0, 0.0)
    if high <= low:
        return np.where(np.isnan(values), np.nan, 0.5)
    return np.clip((values - low) / (high - low), 0.0, 1.0)


def position(call: RewardParams) -> str:
    """Where a car is, in words."""
    side = "left" if call["is_left_of_center"] else "right"
    return (
        f"{call['progress']:.1f} % of the lap, {call['distance_from_center']:.2f} m {side} of the "
        "centre line"
    )


def try_rewards(files: list[Path], course: Course, directory: Path) -> list[TriedReward]:
    """Call reward functions on a course, all at the same time.

    Args:
        files: The files.
        course: What to try them with.
        directory: The racer's working folder.

    Raises:
        SettingsError: A file cannot be read.
    """
    ways = course.drive.waypoints()
    waypoints = [[list(point) for point in ways[way]] for way in (False, True)]
    with ExitStack() as stack:
        running = []
        for file in files:
            text = _read(file)
            request = SandboxRequest(
                display_name(file, directory),
                course.sequences,
                waypoints,
                repeated=len(course.drive.trips),
            )
            sandbox = stack.enter_context(Sandbox(request, text, directory))
            running.append((request.name, sandbox, file, text))
        return [
            TriedReward(name, course, sandbox.result(), file, text)
            for name, sandbox, file, text in running
        ]


def refuse_failing(tried: TriedReward) -> None:
    """Let a function pass that works all along the course, but for unusual states.

    Raises:
        SettingsError: It does not; the sentence says where and why.
    """
    last = len(tried.course.drive.trips)
    for failure in tried.result.failures:
        if failure.first is not None and failure.first.sequence > last:
            continue
        where = f"{tried.name} line {failure.line}" if failure.line else tried.name
        raise SettingsError(
            f"{where}: {failure.sentence()}",
            remedy=f"{REMEDIES[failure.kind]} `dr-reward check {tried.name}` shows every problem.",
        )


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"{file}: the reward function cannot be read: {error.strerror}.",
            remedy="Name a file that you may read, such as custom_files/reward_function.py.",
        ) from None

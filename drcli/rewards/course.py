"""The calls that reward functions are tried with."""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import Problem
from drcli.config.run_config import DriveConfig
from drcli.model.files.custom_files import InputFile
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import read_source
from drcli.rewards.sandbox.run_sandbox import CallIndex, Sandbox, SandboxRequest, SandboxResult
from drcli.rewards.sandbox.sample_calls import places
from drcli.rewards.scripted_drive import FAST, STEADY, Drive, ScriptedDriver, Trip
from drsim.car.car import CONTROL_HZ, REFERENCE_POINT_AHEAD_M, WHEELS_M
from drsim.episode.params import Situation, params_of
from drsim.episode.reward import RewardParams
from drsim.race.objects import Objects
from drsim.race.race import TIME_TRIAL
from drsim.race.traffic import Traffic
from drsim.track.ways import Ways

# Reward parameters of a car at places on and off the road.


Floats = NDArray[np.float64]

SPEED_MPS = 1.5
_HALF = (0.11, 0.22, 0.33, 0.44, 0.56, 0.72)
OFFSETS = (*(-offset for offset in reversed(_HALF)), 0.0, *_HALF)
"""To the left, in road widths. The border is midway between two; at the outermost, all wheels are
off the road.
"""

_SPACING_M = 0.12
_MOST_ALONG = 400
_QUICKER = 0.9


@dataclass(frozen=True)
class Grid:
    """Cars that point along the track.

    Attributes:
        xy: Shape (offsets, n, 2).
        off: All wheels are off the road. Shape (offsets, n).
        objects: Corners. Shape (objects, 4, 2).
        calls: Offset by offset, without waypoints.
    """

    xy: Floats
    off: NDArray[np.bool_]
    objects: Floats
    calls: list[RewardParams]


def track_grid(drive: Drive) -> Grid:
    """An episode at constant speed."""
    track = drive.track
    count = int(min(max(track.length_m / _SPACING_M, 40), _MOST_ALONG))
    along_m = np.linspace(0.0, track.length_m, count, endpoint=False)
    xy, yaw_rad = places(track, along_m, OFFSETS)

    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turns = np.stack([np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)], axis=1)
    origin = xy - REFERENCE_POINT_AHEAD_M * turns[:, 0]
    wheels_on = track.on_road(origin[:, None] + WHEELS_M[:, :2] @ turns).sum(axis=1)
    off = wheels_on == 0

    part = (along_m / track.length_m - drive.start_fraction) % 1.0
    steps = np.round(2 + part * track.length_m / SPEED_MPS * CONTROL_HZ).astype(np.int64)
    objects, outlines = _objects(drive, len(xy))
    situation = Situation(
        xy=xy,
        heading_deg=np.degrees(yaw_rad),
        where=track.locate(xy),
        all_on=wheels_on == len(WHEELS_M),
        none_on=off,
        progress=np.tile(100.0 * part, len(OFFSETS)),
        steps=np.tile(steps, len(OFFSETS)),
        sim_time_s=np.tile(steps / CONTROL_HZ, len(OFFSETS)),
        steering_deg=np.zeros(len(xy)),
        speed_mps=np.full(len(xy), SPEED_MPS),
        way=np.zeros(len(xy), np.int64),
        crashed=np.zeros(len(xy), np.bool_),
        objects=objects,
    )
    calls = list(params_of((track, track.reversed()), situation, np.arange(len(xy))))
    for call in calls:
        del call["waypoints"]
    shape = (len(OFFSETS), count)
    return Grid(xy.reshape(*shape, 2), off.reshape(shape), outlines, calls)


def _objects(drive: Drive, count: int) -> tuple[Objects | None, Floats]:
    if drive.race == TIME_TRIAL:
        return None, np.empty((0, 4, 2))
    traffic = Traffic(Ways([drive.track], 1), drive.race)
    car = np.zeros(1, np.int64)
    traffic.begin(car, np.array([drive.start_fraction]), np.ones(1, np.uint64))
    one = traffic.objects()
    of_each_car = ("xy", "yaw_rad", "distance_m", "from_center_m", "left_of_center")
    repeated = {name: np.repeat(getattr(one, name), count, axis=0) for name in of_each_car}
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2 * one.footprint_m[:, None]
    cos, sin = np.cos(one.yaw_rad[0])[:, None], np.sin(one.yaw_rad[0])[:, None]
    x, y = corners[..., 0], corners[..., 1]
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return one._replace(**repeated), one.xy[0][:, None] + turned


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

    def discounted(self, driver: ScriptedDriver, discount: float) -> float:
        """Sum as seen from the first step; NaN if a call failed."""
        values = as_array(self.values(driver))
        return float(values @ discount ** np.arange(len(values)))

    @property
    def prefers_fast(self) -> bool | None:
        """None without both laps, or if the model's actions make them alike."""
        slow, fast = self.total(STEADY), self.total(FAST)
        steady, quick = self.trip(STEADY), self.trip(FAST)
        whole = steady.whole and quick.whole and quick.seconds < _QUICKER * steady.seconds
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


SandboxOf = Callable[[SandboxRequest, bytes, Path], Sandbox]
"""Of a request, the text of a file, and the working folder."""


def request_of(
    name: str, course: Course, races: list[DriveConfig] | None = None, metadata: str = ""
) -> SandboxRequest:
    """The calls of a course; the last sequence is its grid."""
    ways = course.drive.waypoints()
    waypoints = [[list(point) for point in ways[way]] for way in (False, True)]
    repeated = len(course.drive.trips)
    return SandboxRequest(name, course.sequences, waypoints, repeated, races, metadata=metadata)


def try_rewards(
    files: Sequence[InputFile],
    course: Course,
    directory: Path,
    races: list[DriveConfig] | None = None,
    tolerated: float = 0.0,
    given_up: Event | None = None,
    metadata: str = "",
    sandbox_of: SandboxOf = Sandbox,
) -> list[TriedReward]:
    """Call reward functions at the same time, first on samples of `races`.

    After `given_up`, its values are of no use.
    """
    tried = []
    with ExitStack() as stack:
        running = []
        for file in files:
            source, wrong = read_source(file)
            request = request_of(file.origin, course, races, metadata)
            sandbox = sandbox_of(request, file.data, directory) if source is not None else None
            running.append((file.origin, source, wrong, sandbox and stack.enter_context(sandbox)))
        for name, source, problems, sandbox in running:
            result = SandboxResult(values=[[None] * len(calls) for calls in course.sequences])
            if source is not None and sandbox is not None:
                result = sandbox.result(given_up)
                problems = problems_of(source, result, directory, tolerated)
            text = "" if source is None else source.text
            tried.append(TriedReward(name, course, result, text, problems))
    return tried

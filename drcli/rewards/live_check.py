"""Checks a reward function that is being written.

Drives are kept, and a process that has loaded the simulation, because only the function changes.
"""

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import Problem
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.model.files.custom_files import InputFile
from drcli.model.keys import HYPERPARAMETERS_FILE, MODEL_METADATA_FILE
from drcli.rewards.check import RewardReport, report_of, try_in_each_race
from drcli.rewards.course import Course, each_race
from drcli.rewards.pictures import cell_edges
from drcli.rewards.reward_rules import read_source
from drcli.rewards.sandbox.run_sandbox import Sandbox, SandboxRequest, SandboxServer
from drcli.rewards.scripted_drive import drive, own_actions, read_actions
from drcli.rewards.source import display_name, own_file
from drcli.rewards.track_grid import SPEED_MPS, DrivenCourse
from drcli.rewards.tried_reward import TriedReward, as_array, request_of
from drcli.rewards.try_inputs import races_of, text_of
from drsim.car.actions import Actions

MOST_COURSES = 6
CURVE_POINTS = 150
_PARTS = np.linspace(0.0, 100.0, CURVE_POINTS + 1)
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CoursePicture:
    """What the picture shows besides rewards; metres.

    Attributes:
        key: Changes with track or race.
        rows: From the right of the driving direction to its left.
        columns: Places of a row.
        closed: Whether a row's ends meet.
        edges: Corners of places, row by row. Shape ((rows + 1) * columns, 2).
        inner: Border. Shape (n, 2).
        outer: Border. Shape (n, 2).
        objects: Corners. Shape (objects, 4, 2).
        start: x, y, radians.
        speed_mps: Requested at each place.
    """

    key: str
    world: str
    race_type: str
    rows: int
    columns: int
    closed: bool
    edges: list[list[float]]
    inner: list[list[float]]
    outer: list[list[float]]
    objects: list[list[list[float]]]
    start: list[float]
    speed_mps: float


@dataclass(frozen=True)
class DriverCurve:
    """One driver along the lap; None where it did not drive."""

    name: str
    total: float | None
    seconds: float
    rewards: list[float | None]


@dataclass(frozen=True)
class RewardPicture:
    """Rewards as numbers to draw; without curves before the whole check.

    Attributes:
        course: Key of the `CoursePicture`.
        rewards: Row by row.
        low: Of the first colour; a few may be lower.
        high: Of the last colour; a few may be higher.
        progress: Percent in the middle of each part.
    """

    course: str
    rewards: list[float | None]
    low: float
    high: float
    progress: list[float]
    curves: list[DriverCurve]


@dataclass(frozen=True)
class LiveReport:
    """A check of a function.

    Attributes:
        course: None if the reader knows it.
        more: Whether it is only the picture, and the whole check is to be asked for.
    """

    problems: list[Problem]
    report: RewardReport | None = None
    picture: RewardPicture | None = None
    course: CoursePicture | None = None
    more: bool = False


class LiveCheck:
    """Keeps drives, and a process for the race that is drawn."""

    def __init__(self) -> None:
        self._courses: dict[str, DrivenCourse] = {}
        self._server: SandboxServer | None = None
        self._served: list[str] = []

    def check(
        self,
        settings: Settings,
        text: bytes,
        directory: Path,
        known: str,
        given_up: Event,
        *,
        whole: bool = True,
    ) -> LiveReport | None:
        """As `drcli.rewards.check.check`; None if it was given up.

        `known` is the key of the reader's `CoursePicture`. If not `whole`, only the picture.

        Raises:
            SettingsError: The track is missing, or the race does not fit.
        """
        path = settings.custom_files_dir / "reward_function.py"
        file = InputFile(path.name, text, display_name(path, directory))
        source, wrong = read_source(file)
        if source is None:
            return LiveReport(wrong)
        if not whole:
            return self._drawn(settings, file, directory, known, given_up)
        tried = try_in_each_race(settings, file, directory, self._course, given_up, self._sandbox)
        if given_up.is_set():
            return None
        first = tried[0]
        report = report_of(tried, first.result.discount)
        actions = own_actions(settings)
        key = _key(settings.race, actions)
        found = [*report.errors, *report.warnings, *report.notes]
        picture = _picture(key, first.grid_values, _curves(first))
        course = None if key == known else _picture_of(key, self._driven(settings.race, actions))
        return LiveReport(found, report, picture, course)

    def _drawn(
        self, settings: Settings, file: InputFile, directory: Path, known: str, given_up: Event
    ) -> LiveReport | None:
        metadata, hyperparameters = (
            text_of(own_file(settings, name))
            for name in (MODEL_METADATA_FILE, HYPERPARAMETERS_FILE)
        )
        actions = read_actions(metadata.encode() or None)
        own = each_race(settings.races)[0]
        driven = self._driven(own, actions)
        request = replace(
            request_of(driven.course),
            name=file.origin,
            races=races_of(settings.run),
            metadata=metadata,
            hyperparameters=hyperparameters,
        )
        with self._sandbox(request, file.data, directory, grid_only=True) as sandbox:
            values = sandbox.result(given_up).values
        if given_up.is_set():
            return None
        key = _key(own, actions)
        picture = _picture(key, as_array(values[-1]), []) if values else None
        course = None if key == known else _picture_of(key, driven)
        return LiveReport([], None, picture, course, more=True)

    def _sandbox(
        self,
        request: SandboxRequest,
        text: bytes | None,
        directory: Path,
        *,
        grid_only: bool = False,
    ) -> Sandbox:
        if request.races is None:  # of another race, which is not drawn
            return Sandbox(request, text, directory)
        served = [_key(own, None) for own in request.races]  # other files of tracks change it
        if self._server is None or self._served != served or not self._server.is_for(request):
            self.close()
            self._server, self._served = SandboxServer(request, directory), served
        return Sandbox(request, text, directory, self._server, grid_only=grid_only)

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None

    def _course(self, own: DriveConfig, metadata: str) -> Course:
        return self._driven(own, read_actions(metadata.encode() or None)).course

    def _driven(self, own: DriveConfig, actions: Actions | None) -> DrivenCourse:
        key = _key(own, actions)
        course = self._courses.pop(key, None) or DrivenCourse.of(drive(own, actions))
        self._courses[key] = course
        while len(self._courses) > MOST_COURSES:
            del self._courses[next(iter(self._courses))]
        return course


def _key(own: DriveConfig, actions: Actions | None) -> str:
    values = {name: value for name, value in own.to_json().items() if name != "sources"}
    files = []
    for path in sorted(own.tracks_folder.glob(f"{own.world_name}.*")):
        status = path.stat()
        files.append((path.name, status.st_size, status.st_mtime_ns))
    text = json.dumps([values, files, repr(actions)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _picture_of(key: str, course: DrivenCourse) -> CoursePicture:
    drive_, grid = course.drive, course.grid
    track = drive_.track
    begin = np.array([drive_.start_fraction * track.length_m])
    edges = cell_edges(grid.xy)
    return CoursePicture(
        key=key,
        world=drive_.world,
        race_type=drive_.race_type,
        rows=grid.xy.shape[0],
        columns=grid.xy.shape[1],
        closed=track.closed,
        edges=np.round(edges.reshape(-1, 2), 3).tolist(),
        inner=np.round(track.inner, 3).tolist(),
        outer=np.round(track.outer, 3).tolist(),
        objects=np.round(grid.objects, 3).tolist(),
        start=np.round(track.pose_at(begin)[0], 3).tolist(),
        speed_mps=SPEED_MPS,
    )


def _picture(key: str, grid_values: Floats, curves: list[DriverCurve]) -> RewardPicture | None:
    values = grid_values.reshape(-1)
    known = values[~np.isnan(values)]
    if not len(known):
        return None
    # As in `pictures`: a few extremes have the same colour as the values next to them.
    low, high = np.percentile(known, [0.5, 99.5]).tolist()
    return RewardPicture(
        course=key,
        rewards=[None if np.isnan(value) else float(f"{value:.5g}") for value in values],
        low=low,
        high=high,
        progress=np.round((_PARTS[:-1] + _PARTS[1:]) / 2, 2).tolist(),
        curves=curves,
    )


def _curves(tried: TriedReward) -> list[DriverCurve]:
    return [
        DriverCurve(
            trip.driver.name,
            tried.total(trip.driver),
            round(trip.seconds, 2),
            _means(
                np.array([call["progress"] for call in trip.calls]),
                as_array(tried.values(trip.driver)),
            ),
        )
        for trip in tried.course.trips
    ]


def _means(progress: Floats, values: Floats) -> list[float | None]:
    part = np.clip(np.digitize(progress, _PARTS) - 1, 0, CURVE_POINTS - 1)
    good = ~np.isnan(values)
    sums = np.bincount(part[good], values[good], CURVE_POINTS)
    counts = np.bincount(part[good], minlength=CURVE_POINTS)
    return [
        float(f"{total / count:.5g}") if count else None
        for total, count in zip(sums, counts, strict=True)
    ]

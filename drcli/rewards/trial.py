"""A reward function on trial: who drove, what it was asked, what it answered."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.checks.sandbox.parent import Hearing, Questions
from drcli.checks.sandbox.statement import Place, Statement
from drcli.rewards.drivers import STEADY, Pilot
from drcli.rewards.scripted_drive import Drive, Trip
from drcli.rewards.track_grid import Field, field, unusual
from drsim.episode.reward import RewardParams


@dataclass(frozen=True)
class Course:
    """All calls that functions are tried with.

    Attributes:
        drive: What the drivers met.
        field: Places on the road and beside it.
        unusual: Single states that a drive does not come to, by name.
    """

    drive: Drive
    field: Field
    unusual: dict[str, RewardParams]

    @staticmethod
    def of(drive: Drive) -> "Course":
        """The course of a drive."""
        return Course(drive, field(drive), unusual(drive, drive.trip(STEADY).calls))

    def questions(self) -> Questions:
        """The calls: the drivers' first, then the field, then what is unusual."""
        trips = [trip.calls for trip in self.drive.trips]
        return Questions(
            [*trips, self.field.calls, list(self.unusual.values())],
            len(trips),
            self.drive.waypoints(),
        )

    @property
    def size(self) -> int:
        """How many calls there are."""
        return sum(map(len, self.questions().sequences))


@dataclass(frozen=True)
class Trial:
    """One function on a course.

    Attributes:
        name: What its author calls the file.
        course: What it was tried with.
        statement: What it did.
    """

    name: str
    course: Course
    statement: Statement

    def values(self, pilot: Pilot) -> list[float | None]:
        """What it paid a driver at each step."""
        return self.statement.values[self.course.drive.trips.index(self.trip(pilot))]

    def trip(self, pilot: Pilot) -> Trip:
        """What a driver did."""
        return self.course.drive.trip(pilot)

    def total(self, pilot: Pilot) -> float | None:
        """What it paid a driver altogether; None if a call failed or was not made."""
        values = self.values(pilot)
        paid = [value for value in values if value is not None]
        return sum(paid) if len(paid) == len(values) else None

    def mean(self, pilot: Pilot) -> float | None:
        """What it paid a driver for a step."""
        total = self.total(pilot)
        return None if total is None else total / len(self.values(pilot))

    @property
    def field_values(self) -> list[float | None]:
        """What it paid for the places of the field, offset by offset."""
        return self.statement.values[len(self.course.drive.trips)]

    def describe(self, place: Place) -> str:
        """A call in words."""
        trips = self.course.drive.trips
        if place.sequence > len(trips):
            return list(self.course.unusual)[place.index]
        if place.sequence == len(trips):
            call, who = self.course.field.calls[place.index], "a car placed on the track"
        else:
            trip = trips[place.sequence]
            call, who = trip.calls[place.index], f"{trip.pilot.name} driver, step {place.index + 2}"
        return f"{who}, {described(call)}"


def described(call: RewardParams) -> str:
    """Where a car is."""
    side = "left" if call["is_left_of_center"] else "right"
    return (
        f"{call['progress']:.1f} % of the lap, {call['distance_from_center']:.2f} m {side} of the "
        "centre line"
    )


def try_out(files: list[tuple[Path, str]], course: Course, directory: Path) -> list[Trial]:
    """Have reward functions called on a course, all at the same time.

    Args:
        files: Each file, and what its author calls it.
        course: What to try them with.
        directory: The racer's working folder.

    Raises:
        SettingsError: A file cannot be read.
    """
    questions = course.questions()
    hearings: list[tuple[str, Hearing]] = []
    try:
        for path, name in files:
            hearings.append((name, Hearing(path, questions, directory)))
        return [Trial(name, course, hearing.statement()) for name, hearing in hearings]
    finally:
        for _, hearing in hearings:
            hearing.close()


def refuse_failing(trial: Trial) -> None:
    """Let a function pass that works all along the course.

    Raises:
        SettingsError: It does not; the sentence says where and why.
    """
    drawn = len(trial.course.drive.trips)
    for failure in trial.statement.failures:
        if failure.first is not None and failure.first.sequence > drawn:
            continue
        where = f"{trial.name} line {failure.line}" if failure.line else trial.name
        raise SettingsError(
            f"{where}: {failure.sentence}",
            remedy=f"Correct it; `dr-reward check {trial.name}` tells all that is wrong.",
        )

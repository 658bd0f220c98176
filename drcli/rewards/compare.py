"""Compares two reward functions: what they pay the same drivers, and where they differ most."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drcli.config.settings import Settings
from drcli.rewards.drivers import FAST, STEADY
from drcli.rewards.scripted_drive import drive
from drcli.rewards.source import display_name, files_of
from drcli.rewards.trial import Course, Trial, described, refuse_failing, try_out

Floats = NDArray[np.float64]

_PLACES = 3
_ALIKE = 0.05
"""Shares of the range that are not told as a difference."""


@dataclass(frozen=True)
class DriverComparison:
    """What two functions pay one driver.

    Attributes:
        name: The driver.
        about: What it does.
        steps: Steps that were paid.
        seconds: Simulated time.
        first_total: Sum of the rewards of the first function.
        second_total: Of the second one.
        first_mean: Reward a step of the first one.
        second_mean: Of the second one.
    """

    name: str
    about: str
    steps: int
    seconds: float
    first_total: float
    second_total: float
    first_mean: float
    second_mean: float


@dataclass(frozen=True)
class PlaceComparison:
    """A step that the functions see differently.

    Attributes:
        place: Which one, in words.
        first: Reward of the first function.
        second: Of the second one.
        difference: Second less first, where each is scaled to what it pays on the drive:
            -1 to 1.
    """

    place: str
    first: float
    second: float
    difference: float


@dataclass(frozen=True)
class ComparisonReport:
    """Two functions on the same drive.

    Attributes:
        first: File of the first function.
        second: Of the second one.
        world: The track.
        race_type: The race.
        correlation: Of the rewards of all steps, -1 to 1; None where one is always the same.
        rank_correlation: Of their order.
        drivers: Each driver.
        places: Where they differ most, each scaled to what it pays on the drive.
        first_prefers_fast: The first one pays a fast lap more than a slow one; None where a lap
            was not completed.
        second_prefers_fast: The same of the second one.
        picture: The picture, if one was asked for.
    """

    first: str
    second: str
    world: str
    race_type: str
    correlation: float | None
    rank_correlation: float | None
    drivers: list[DriverComparison]
    places: list[PlaceComparison]
    first_prefers_fast: bool | None
    second_prefers_fast: bool | None
    picture: str | None


def compare(
    settings: Settings, first: Path, second: Path, out: Path | None, directory: Path
) -> ComparisonReport:
    """Try two functions on the same drive over the configured track.

    Args:
        settings: The track, the race and the direction.
        first: A function.
        second: Another one.
        out: A picture to draw, a PNG file; what is there is replaced.
        directory: The racer's working folder.

    Raises:
        SettingsError: One of them fails, there is no such track, or the picture cannot be written.
    """
    files = files_of([first, second])
    course = Course.of(drive(settings.race))
    if out is not None:
        from drcli.rewards.canvas import refuse_replacing

        refuse_replacing(out)
    trials = try_out([(file, display_name(file, directory)) for file in files], course, directory)
    for trial in trials:
        refuse_failing(trial)
    if out is not None:
        from drcli.rewards.comparison_picture import picture_of

        picture_of(*trials).save(out)
    return _report(*trials, picture=str(out) if out else None)


def scaled(values: Floats, over: Floats) -> Floats:
    """Values from 0 to 1, where these are the least and the greatest of others."""
    known = over[~np.isnan(over)]
    low, high = np.percentile(known, [1, 99]).tolist() if len(known) else (0.0, 0.0)
    if high <= low:
        return np.where(np.isnan(values), np.nan, 0.5)
    return np.clip((values - low) / (high - low), 0.0, 1.0)


def drive_values(trial: Trial) -> Floats:
    """What it pays all drivers, one after the other; NaN where it was not asked. Shape (n,)."""
    trips = len(trial.course.drive.trips)
    values = [value for trip in trial.statement.values[:trips] for value in trip]
    return np.array([math.nan if value is None else value for value in values])


def _report(first: Trial, second: Trial, *, picture: str | None) -> ComparisonReport:
    a, b = drive_values(first), drive_values(second)
    both = ~np.isnan(a) & ~np.isnan(b)
    return ComparisonReport(
        first=first.name,
        second=second.name,
        world=first.course.drive.world,
        race_type=first.course.drive.race_type,
        correlation=_correlation(a[both], b[both]),
        rank_correlation=_correlation(_ranks(a[both]), _ranks(b[both])),
        drivers=_drivers(first, second),
        places=_places(first, a, b),
        first_prefers_fast=_prefers_fast(first),
        second_prefers_fast=_prefers_fast(second),
        picture=picture,
    )


def _drivers(first: Trial, second: Trial) -> list[DriverComparison]:
    found = []
    for trip in first.course.drive.trips:
        totals = first.total(trip.pilot), second.total(trip.pilot)
        if totals[0] is None or totals[1] is None:
            continue
        steps = len(trip.calls)
        found.append(
            DriverComparison(
                trip.pilot.name,
                trip.pilot.about,
                steps,
                round(trip.seconds, 3),
                totals[0],
                totals[1],
                totals[0] / steps,
                totals[1] / steps,
            )
        )
    return found


def _places(trial: Trial, a: Floats, b: Floats) -> list[PlaceComparison]:
    """Where the second one pays otherwise than the first, the most first, one for each driver."""
    difference = scaled(b, b) - scaled(a, a)
    steps = [(trip, k) for trip in trial.course.drive.trips for k in range(len(trip.calls))]
    order = np.argsort(-np.abs(np.nan_to_num(difference)), kind="stable").tolist()
    chosen: list[int] = []
    for n in order:
        if len(chosen) == _PLACES or not abs(difference[n]) > _ALIKE:
            break
        if all(steps[n][0] is not steps[m][0] for m in chosen):
            chosen.append(n)
    return [
        PlaceComparison(
            f"{steps[n][0].pilot.name} driver, {described(steps[n][0].calls[steps[n][1]])}",
            float(a[n]),
            float(b[n]),
            round(float(difference[n]), 4),
        )
        for n in chosen
    ]


def _prefers_fast(trial: Trial) -> bool | None:
    steady, fast = trial.total(STEADY), trial.total(FAST)
    whole = trial.trip(STEADY).whole and trial.trip(FAST).whole
    return None if steady is None or fast is None or not whole else fast > steady


def _correlation(a: Floats, b: Floats) -> float | None:
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    return round(float(np.corrcoef(a, b)[0, 1]), 4)


def _ranks(values: Floats) -> Floats:
    """Place of each value in their order; equal values share theirs. Shape (n,)."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    shared: Floats = (ends - (counts - 1) / 2.0)[which]
    return shared

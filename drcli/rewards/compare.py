"""Compares two reward functions: what they pay the same drivers, and where they differ most."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drcli.base.atomic_file import rewrite
from drcli.config.settings import Settings
from drcli.rewards.course import (
    Course,
    TriedReward,
    position,
    refuse_failing,
    scaled,
    try_rewards,
)
from drcli.rewards.pictures import draw_comparison, refuse_replacing
from drcli.rewards.scripted_drive import drive
from drcli.rewards.source import files_of

Floats = NDArray[np.float64]

_PLACES = 3
_ALIKE = 0.05
"""A difference of less than this share of the range is not worth telling."""


@dataclass(frozen=True)
class DriverComparison:
    """What two functions pay one driver.

    Attributes:
        name: The driver.
        about: What it does.
        steps: Steps that were paid.
        seconds: Simulated time.
        first_total: Sum of the rewards of the first function.
        second_total: Sum of the rewards of the second one.
        first_mean: Reward per step of the first one.
        second_mean: Reward per step of the second one.
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
    """A step for which the functions pay differently.

    Attributes:
        place: Which one, in words.
        first: Reward of the first function.
        second: Reward of the second one.
        difference: Second minus first, each scaled to what it pays on the drive: -1 to 1.
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
        second: File of the second one.
        world: The track.
        race_type: The race.
        correlation: Correlation of the rewards of all steps, -1 to 1; None if one is constant.
        rank_correlation: Correlation of their ranks.
        drivers: What each driver is paid.
        places: Where they differ most, each scaled to what it pays on the drive.
        first_prefers_fast: The first one pays more for a fast lap than for a slow one; None if a
            lap was not completed.
        second_prefers_fast: The same for the second one.
        picture: File of the picture, if one was asked for.
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
        out: A picture to draw, a PNG file; an older one is replaced.
        directory: The racer's working folder.

    Raises:
        SettingsError: One of them fails, there is no such track, or the picture cannot be written.
    """
    files = files_of([first, second])
    if out is not None:
        refuse_replacing(out)
    course = Course.of(drive(settings.race))
    both = try_rewards(files, course, directory)
    for tried in both:
        refuse_failing(tried)
    if out is not None:
        rewrite(out, draw_comparison(*both))
    return _report(*both, picture=str(out) if out else None)


def _report(first: TriedReward, second: TriedReward, *, picture: str | None) -> ComparisonReport:
    a, b = first.drive_values, second.drive_values
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
        first_prefers_fast=first.prefers_fast,
        second_prefers_fast=second.prefers_fast,
        picture=picture,
    )


def _drivers(first: TriedReward, second: TriedReward) -> list[DriverComparison]:
    found = []
    for trip in first.course.drive.trips:
        totals = first.total(trip.driver), second.total(trip.driver)
        if totals[0] is None or totals[1] is None:
            continue
        steps = len(trip.calls)
        found.append(
            DriverComparison(
                trip.driver.name,
                trip.driver.about,
                steps,
                round(trip.seconds, 3),
                totals[0],
                totals[1],
                totals[0] / steps,
                totals[1] / steps,
            )
        )
    return found


def _places(tried: TriedReward, a: Floats, b: Floats) -> list[PlaceComparison]:
    """Where the functions differ most, at most one step of each driver."""
    difference = scaled(b, b) - scaled(a, a)
    steps = [(trip, k) for trip in tried.course.drive.trips for k in range(len(trip.calls))]
    order = np.argsort(-np.abs(np.nan_to_num(difference)), kind="stable").tolist()
    chosen: list[int] = []
    for n in order:
        if len(chosen) == _PLACES or not abs(difference[n]) > _ALIKE:
            break
        if all(steps[n][0] is not steps[m][0] for m in chosen):
            chosen.append(n)
    return [
        PlaceComparison(
            f"{steps[n][0].driver.name} driver, {position(steps[n][0].calls[steps[n][1]])}",
            float(a[n]),
            float(b[n]),
            round(float(difference[n]), 4),
        )
        for n in chosen
    ]


def _correlation(a: Floats, b: Floats) -> float | None:
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    return round(float(np.corrcoef(a, b)[0, 1]), 4)


def _ranks(values: Floats) -> Floats:
    """Rank of each value; equal values share theirs. Shape (n,)."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    shared: Floats = (ends - (counts - 1) / 2.0)[which]
    return shared

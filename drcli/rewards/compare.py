"""Compares two reward functions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import refuse
from drcli.base.files import refuse_replacing, rewrite
from drcli.config.settings import Settings
from drcli.rewards.course import Course, TriedReward, position, scaled, try_rewards
from drcli.rewards.pictures import draw_comparison
from drcli.rewards.scripted_drive import drive
from drcli.rewards.source import read_files

Floats = NDArray[np.float64]

_PLACES = 3
_ALIKE = 0.05


@dataclass(frozen=True)
class DriverComparison:
    """The rewards of one driver.

    Attributes:
        name: The driver.
        about: Its way of driving.
        steps: Steps with a reward.
        seconds: Simulated time.
        first_total: Sum of the first function's rewards.
        second_total: Sum of the second one's.
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
    """A step with different rewards.

    Attributes:
        place: The step, in words.
        first: Reward of the first function.
        second: Reward of the second one.
        difference: Second minus first, each scaled to its range on the drive: -1 to 1.
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
        correlation: Correlation of the rewards, -1 to 1; None if one is constant.
        rank_correlation: Correlation of their ranks.
        drivers: Rewards of each driver.
        places: Where they differ most, each scaled to its range; empty if one is constant.
        first_prefers_fast: Whether the first gives more for a fast lap than for a slow one; None if
            a lap was not completed.
        second_prefers_fast: The same for the second.
        picture: File of the picture, if requested.
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
    settings: Settings,
    first: Path,
    second: Path,
    out: Path | None,
    directory: Path,
    *,
    force: bool = False,
) -> ComparisonReport:
    """Try two functions on the same drive; `out`: a PNG file.

    Raises:
        SettingsError: A function fails, or track or picture does.
    """
    files = read_files([first, second], directory)
    if out is not None:
        refuse_replacing(out, force=force)
    course = Course.of(drive(settings.race))
    both = try_rewards(files, course, directory)
    refuse(problem for tried in both for problem in tried.problems)
    if out is not None:
        rewrite(out, draw_comparison(*both))
    return _report(*both, picture=str(out) if out else None)


def _report(first: TriedReward, second: TriedReward, *, picture: str | None) -> ComparisonReport:
    a, b = first.drive_values, second.drive_values
    both = ~np.isnan(a) & ~np.isnan(b)
    correlation = _correlation(a[both], b[both])
    return ComparisonReport(
        first=first.name,
        second=second.name,
        world=first.course.drive.world,
        race_type=first.course.drive.race_type,
        correlation=correlation,
        rank_correlation=_correlation(_ranks(a[both]), _ranks(b[both])),
        drivers=_drivers(first, second),
        places=[] if correlation is None else _places(first, a, b),
        first_prefers_fast=first.prefers_fast,
        second_prefers_fast=second.prefers_fast,
        picture=picture,
    )


def _drivers(first: TriedReward, second: TriedReward) -> list[DriverComparison]:
    found = []
    for trip in first.course.drive.trips:
        name, about, steps = trip.driver.name, trip.driver.about, len(trip.calls)
        a, b = first.total(trip.driver), second.total(trip.driver)
        if a is not None and b is not None:
            each = (a, b, a / steps, b / steps)
            found.append(DriverComparison(name, about, steps, round(trip.seconds, 3), *each))
    return found


def _places(tried: TriedReward, a: Floats, b: Floats) -> list[PlaceComparison]:
    difference = scaled(b, b) - scaled(a, a)
    steps = [(trip, k) for trip in tried.course.drive.trips for k in range(len(trip.calls))]
    chosen: dict[str, PlaceComparison] = {}
    for n in np.argsort(-np.abs(np.nan_to_num(difference)), kind="stable").tolist():
        if len(chosen) == _PLACES or not abs(difference[n]) > _ALIKE:
            break
        trip, k = steps[n]
        place = f"{trip.driver.name} driver, {position(trip.calls[k])}"
        apart = round(float(difference[n]), 4)
        first = PlaceComparison(place, float(a[n]), float(b[n]), apart)
        chosen.setdefault(trip.driver.name, first)
    return list(chosen.values())


def _correlation(a: Floats, b: Floats) -> float | None:
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    return round(float(np.corrcoef(a, b)[0, 1]), 4)


def _ranks(values: Floats) -> Floats:
    """Equal values share theirs. Shape (n,)."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    shared: Floats = (ends - (counts - 1) / 2.0)[which]
    return shared

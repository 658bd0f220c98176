"""Compares two reward functions."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import refuse
from drcli.base.files import refuse_replacing, rewrite
from drcli.base.report import BLANK, Col, View, bold, compact, dim, table
from drcli.config.settings import Settings
from drcli.rewards.course import position
from drcli.rewards.pictures import draw_comparison
from drcli.rewards.scripted_drive import drive, own_actions
from drcli.rewards.source import read_files
from drcli.rewards.track_grid import DrivenCourse
from drcli.rewards.tried_reward import TriedReward, scaled, try_rewards

Floats = NDArray[np.float64]

_PLACES = 3
_ALIKE = 0.05


@dataclass(frozen=True)
class DriverComparison:
    """The rewards of one driver."""

    name: Annotated[str, "The driver.", Col("driver")]
    about: Annotated[str, "Its way of driving."]
    steps: Annotated[int, "Steps with a reward.", Col("steps")]
    seconds: Annotated[float, "Simulated time.", Col("time", "{:.1f} s")]
    first_total: Annotated[float, "Sum of the first function's rewards.", Col("A per lap", compact)]
    second_total: Annotated[float, "Sum of the second one's.", Col("B per lap", compact)]
    first_mean: Annotated[float, "Reward per step of the first one.", Col("A per step", compact)]
    second_mean: Annotated[float, "Reward per step of the second one.", Col("B per step", compact)]


@dataclass(frozen=True)
class PlaceComparison:
    """A step with different rewards."""

    place: Annotated[str, "The step, in words."]
    first: Annotated[float, "Reward of the first function."]
    second: Annotated[float, "Reward of the second one."]
    difference: Annotated[
        float, "Second minus first, each scaled to its range on the drive: -1 to 1."
    ]


@dataclass(frozen=True)
class ComparisonReport:
    """Two functions on the same drive."""

    first: Annotated[str, "File of the first function."]
    second: Annotated[str, "File of the second one."]
    world: Annotated[str, "The track."]
    race_type: Annotated[str, "The race."]
    correlation: Annotated[
        float | None, "Correlation of the rewards, -1 to 1; None if one is constant."
    ]
    rank_correlation: Annotated[float | None, "Correlation of their ranks."]
    drivers: Annotated[list[DriverComparison], "Rewards of each driver."]
    places: Annotated[
        list[PlaceComparison],
        "Where they differ most, each scaled to its range; empty if one is constant.",
    ]
    first_prefers_fast: Annotated[
        bool | None,
        "Whether the first gives more for a fast lap than for a slow one; None if a lap "
        "was not completed, or both take as long.",
    ]
    second_prefers_fast: Annotated[bool | None, "The same for the second."]
    picture: Annotated[str | None, "File of the picture, if requested."]

    def view(self) -> View:
        correlation = "One of them pays the same everywhere, so there is no correlation."
        if self.correlation is not None and self.rank_correlation is not None:
            correlation = (
                f"Correlation of all steps: {self.correlation:.2f}, of their ranks: "
                f"{self.rank_correlation:.2f} (1: the same goals)."
            )
        yield from ((bold("A: "), self.first), (bold("B: "), self.second))
        yield dim(f"on {self.world}, {self.race_type}")
        yield from (BLANK, table(self.drivers), BLANK, correlation)
        for name, prefers in (("A", self.first_prefers_fast), ("B", self.second_prefers_fast)):
            lap = "a fast" if prefers else "a slow"
            yield prefers is not None and f"{name} pays more for {lap} lap."
        if self.places:
            yield BLANK
            yield "The steps at which they differ most, with both scaled to the same range:"
            yield [
                f"{place.place}: A {compact(place.first)}, B {compact(place.second)}"
                for place in self.places
            ]
        yield self.picture and ("Picture: ", bold(self.picture))


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
    driven = DrivenCourse.of(drive(settings.race, own_actions(settings)))
    both = try_rewards(files, driven.course, directory)
    refuse(problem for tried in both for problem in tried.problems)
    if out is not None:
        rewrite(out, draw_comparison(driven, *both))
    return _report(*both, picture=str(out) if out else None)


def _report(first: TriedReward, second: TriedReward, *, picture: str | None) -> ComparisonReport:
    a, b = first.drive_values, second.drive_values
    both = ~np.isnan(a) & ~np.isnan(b)
    correlation = _correlation(a[both], b[both])
    return ComparisonReport(
        first=first.name,
        second=second.name,
        world=first.course.world,
        race_type=first.course.race_type,
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
    for trip in first.course.trips:
        name, about, steps = trip.driver.name, trip.driver.about, len(trip.calls)
        a, b = first.total(trip.driver), second.total(trip.driver)
        if a is not None and b is not None:
            each = (a, b, a / steps, b / steps)
            found.append(DriverComparison(name, about, steps, round(trip.seconds, 3), *each))
    return found


def _places(tried: TriedReward, a: Floats, b: Floats) -> list[PlaceComparison]:
    difference = scaled(b, b) - scaled(a, a)
    steps = [(trip, k) for trip in tried.course.trips for k in range(len(trip.calls))]
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

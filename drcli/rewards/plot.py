"""Plots a reward function."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drcli.base.atomic_file import rewrite
from drcli.base.problems import refuse
from drcli.base.replaceable import refuse_replacing
from drcli.config.settings import Settings
from drcli.rewards.course import Course, try_rewards
from drcli.rewards.pictures import draw_reward
from drcli.rewards.scripted_drive import drive
from drcli.rewards.source import read_racers_file


@dataclass(frozen=True)
class PlotReport:
    """A picture that was drawn.

    Attributes:
        file: The reward function.
        world: The track.
        picture: File of the picture.
        replaced: Whether it replaced an older file.
        least: Least reward on the map.
        greatest: Greatest reward on the map.
        laps: The sum of the rewards of each driver, by name.
    """

    file: str
    world: str
    picture: str
    replaced: bool
    least: float
    greatest: float
    laps: dict[str, float]


def plot(
    settings: Settings, file: Path | None, out: Path, directory: Path, *, force: bool = False
) -> PlotReport:
    """As a PNG file.

    Raises:
        SettingsError: The function fails, or track or picture does.
    """
    read = read_racers_file(settings, file, directory)
    refuse_replacing(out, force=force)
    course = Course.of(drive(settings.race))
    [tried] = try_rewards([read], course, directory)
    refuse(tried.problems)
    replaced = out.exists()
    rewrite(out, draw_reward(tried))
    values = tried.grid_values
    totals = {trip.driver.name: tried.total(trip.driver) for trip in course.drive.trips}
    return PlotReport(
        tried.name,
        course.drive.world,
        str(out),
        replaced,
        float(np.nanmin(values)),
        float(np.nanmax(values)),
        {name: total for name, total in totals.items() if total is not None},
    )

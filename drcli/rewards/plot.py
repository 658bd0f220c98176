"""Plots a reward function: a map of the track, and curves along the lap."""

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
        least: The least reward on the map.
        greatest: The greatest reward on the map.
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
    """Draw the rewards of a function on the configured track.

    Args:
        settings: The track, the race and the direction.
        file: The function; None takes that of a training.
        out: The picture, a PNG file.
        directory: The racer's working folder.
        force: Whether an existing picture may be replaced.

    Raises:
        SettingsError: The function fails, the track does not exist, or the picture cannot be
            written.
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

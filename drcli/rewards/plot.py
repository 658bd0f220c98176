"""A picture of what a reward function pays: a map of the track, and curves along the lap."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drcli.config.settings import Settings
from drcli.rewards.canvas import FAINT, LINES, Canvas, number, refuse_replacing, sequential
from drcli.rewards.panels import Box, Curve, Scale, draw_curves, draw_map, height_of_map
from drcli.rewards.scripted_drive import Trip, drive
from drcli.rewards.source import display_name, file_of
from drcli.rewards.track_grid import SPEED_MPS
from drcli.rewards.trial import Course, Trial, refuse_failing, try_out

Floats = NDArray[np.float64]

_WIDTH, _MARGIN, _HEAD, _CURVES = 1400, 36, 92, 340
_CLEAR = 2.0
"""A finish that pays so many times more than the rest would flatten every curve: it is told."""


@dataclass(frozen=True)
class PlotReport:
    """A picture that was drawn.

    Attributes:
        file: The reward function.
        world: The track.
        picture: Where the picture is.
        replaced: There was a file of that name before.
        least: The least reward on the map.
        greatest: The greatest one.
        laps: What each driver earned, by name.
    """

    file: str
    world: str
    picture: str
    replaced: bool
    least: float
    greatest: float
    laps: dict[str, float]


def plot(settings: Settings, file: Path | None, out: Path, directory: Path) -> PlotReport:
    """Draw what a reward function pays on the configured track.

    Args:
        settings: The track, the race and the direction.
        file: The function; that of the training when left out.
        out: The picture, a PNG file; what is there is replaced.
        directory: The racer's working folder.

    Raises:
        SettingsError: The function fails, there is no such track, or the picture cannot be written.
    """
    path = file_of(settings, file)
    refuse_replacing(out)
    course = Course.of(drive(settings.race))
    [trial] = try_out([(path, display_name(path, directory))], course, directory)
    refuse_failing(trial)
    replaced = out.exists()
    picture_of(trial).save(out)
    values = field_array(trial)
    laps = {trip.pilot.name: trial.total(trip.pilot) for trip in course.drive.trips}
    return PlotReport(
        trial.name,
        course.drive.world,
        str(out),
        replaced,
        float(np.nanmin(values)),
        float(np.nanmax(values)),
        {name: total for name, total in laps.items() if total is not None},
    )


def picture_of(trial: Trial) -> Canvas:
    """The picture of one function."""
    drive_ = trial.course.drive
    width = _WIDTH - 2 * _MARGIN
    map_height = height_of_map(drive_.track, width)
    canvas = Canvas(_WIDTH, int(_HEAD + map_height + 40 + _CURVES + _MARGIN))
    canvas.text(_MARGIN, 26, trial.name, size=24)
    canvas.text(
        _MARGIN,
        60,
        f"{drive_.world}, {drive_.race_type}. Colours: what a car is paid that stands there, looks "
        f"along the track and asks for {SPEED_MPS:g} m/s.",
        size=15,
        color=FAINT,
    )
    values = field_array(trial)
    draw_map(
        canvas,
        Box(_MARGIN, _HEAD, width, map_height),
        drive_.track,
        trial.course.field,
        values,
        color_scale(values),
        drive_.start_fraction,
    )
    curves = [curve_of(trial, trip, LINES[k % len(LINES)]) for k, trip in enumerate(drive_.trips)]
    low, high, cut = curve_range(curves)
    draw_curves(
        canvas,
        Box(_MARGIN, _HEAD + map_height + 40, width, _CURVES),
        curves,
        f"Reward at each step, and its sum{cut}",
        low=low,
        high=high,
    )
    return canvas


def field_array(trial: Trial) -> Floats:
    """What it pays for the places of the field, NaN where it was not asked. Shape (offsets, n)."""
    values = [math.nan if value is None else value for value in trial.field_values]
    return np.array(values).reshape(trial.course.field.off.shape)


def color_scale(values: Floats) -> Scale:
    """Colours for values, a few extreme ones left out."""
    known = values[~np.isnan(values)]
    low, high = np.percentile(known, [0.5, 99.5]).tolist() if len(known) else (0.0, 0.0)
    return Scale(low, high, sequential)


def curve_of(trial: Trial, trip: Trip, color: tuple[int, int, int]) -> Curve:
    """What it pays a driver, with the sum in its name."""
    values = trial.values(trip.pilot)
    total = trial.total(trip.pilot)
    earned = "" if total is None else f" {number(total)}"
    return Curve(
        f"{trip.pilot.name}{earned} in {trip.seconds:.1f} s",
        color,
        np.array([call["progress"] for call in trip.calls]),
        np.array([math.nan if value is None else value for value in values]),
    )


def curve_range(curves: list[Curve]) -> tuple[float, float, str]:
    """Least and greatest value to show, and a remark where a finish goes beyond."""
    values = np.concatenate([curve.values for curve in curves])
    finish = np.concatenate([curve.progress for curve in curves]) >= 100.0
    known = ~np.isnan(values)
    if not known.any():
        return 0.0, 1.0, ""
    low, high = float(values[known].min()), float(values[known].max())
    before = values[known & ~finish]
    if len(before) and finish[known].any():
        usual = float(before.max())
        if high - low > _CLEAR * (usual - min(low, float(before.min()))) > 0:
            return low, usual, f" (cut: the finish pays up to {number(high)})"
    return low, high, ""

"""A picture of two reward functions: both maps, where they differ, and a lap through both."""

from drcli.rewards.canvas import FAINT, LINES, Canvas, diverging
from drcli.rewards.compare import drive_values, scaled
from drcli.rewards.drivers import FAST, STEADY
from drcli.rewards.panels import Box, Curve, Scale, draw_curves, draw_map, height_of_map
from drcli.rewards.plot import Floats, color_scale, curve_of, field_array
from drcli.rewards.track_grid import SPEED_MPS
from drcli.rewards.trial import Trial

_COLUMN, _MARGIN, _HEAD, _TITLE = 760, 36, 84, 34


def picture_of(first: Trial, second: Trial) -> Canvas:
    """The picture of two functions on one course."""
    drive = first.course.drive
    map_height = height_of_map(drive.track, _COLUMN)
    row = _TITLE + map_height + 24
    canvas = Canvas(2 * _COLUMN + 3 * _MARGIN, int(_HEAD + 2 * row + _MARGIN))
    canvas.text(_MARGIN, 24, f"A: {first.name}    B: {second.name}", size=22)
    canvas.text(
        _MARGIN,
        56,
        f"{drive.world}, {drive.race_type}. Colours: what a car is paid that looks along the track "
        f"and asks for {SPEED_MPS:g} m/s.",
        size=15,
        color=FAINT,
    )
    a, b = field_array(first), field_array(second)
    apart = scaled(b, b) - scaled(a, a)
    columns = (_MARGIN, 2 * _MARGIN + _COLUMN)
    for left, top, title, values, scale in (
        (columns[0], _HEAD, "A", a, color_scale(a)),
        (columns[1], _HEAD, "B", b, color_scale(b)),
        (
            columns[0],
            _HEAD + row,
            "Red: B pays more, blue: A does (both scaled to 0 .. 1)",
            apart,
            Scale(-1.0, 1.0, lambda share: diverging(2 * share - 1)),
        ),
    ):
        canvas.text(left, top, title, size=17)
        draw_map(
            canvas,
            Box(left, top + _TITLE, _COLUMN, map_height),
            drive.track,
            first.course.field,
            values,
            scale,
            drive.start_fraction,
        )
    draw_curves(
        canvas,
        Box(columns[1], _HEAD + row, _COLUMN, row - 24),
        _curves(first, second),
        "Reward at each step, both scaled to 0 .. 1; sums unscaled",
        low=0.0,
        high=1.0,
    )
    return canvas


def _curves(first: Trial, second: Trial) -> list[Curve]:
    curves = []
    for name, trial, colors in (("A", first, LINES[:2]), ("B", second, LINES[2:4])):
        over = drive_values(trial)
        for pilot, color in zip((STEADY, FAST), colors, strict=True):
            curve = curve_of(trial, trial.trip(pilot), color)
            values: Floats = scaled(curve.values, over)
            curves.append(Curve(f"{name} {curve.name}", color, curve.progress, values))
    return curves

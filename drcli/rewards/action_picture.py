"""Draws an action space: steering as direction, speed as distance."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

from drcli.base.png_picture import INK, png
from drcli.modelfiles.action_space import ActionSpace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

_BLUE = "#0072b2"
_MOST_LABELS = 40
_LEAST_WIDTH_DEG = 30.0


def draw_actions(space: ActionSpace, shares: Sequence[float], title: str) -> bytes:
    """`shares` of the steps, 0 .. 1, may be empty."""
    corners = [space.low, space.high] if space.low and space.high else space.values
    widest = max(_LEAST_WIDTH_DEG, *(abs(angle) for angle, _ in corners))
    fastest = max(speed for _, speed in corners)

    def draw(figure: "Figure") -> None:
        figure.suptitle(title, x=0.02, ha="left", color=INK)
        axes = cast("PolarAxes", figure.add_subplot(projection="polar"))
        axes.set_theta_zero_location("N")
        axes.set_thetamin(-widest - 3.0)
        axes.set_thetamax(widest + 3.0)
        axes.set_rlim(0.0, 1.12 * fastest)
        axes.set_xticks([math.radians(angle) for angle in _ticks(widest)])
        axes.set_xticklabels([_angle(angle) for angle in _ticks(widest)])
        axes.set_xlabel("speed, m/s; steering, degrees, L left, R right", color=INK)
        if space.low and space.high:
            _draw_ranges(axes, space.low, space.high)
        else:
            _draw_list(axes, space.values, shares)

    return png(draw, (7.0, 7.0))


def _draw_list(
    axes: "Axes", actions: Sequence[tuple[float, float]], shares: Sequence[float]
) -> None:
    sizes: Any = [60.0 + 1800.0 * share for share in shares] or 90.0
    angles = [math.radians(angle) for angle, _ in actions]
    speeds = [speed for _, speed in actions]
    for angle, speed in zip(angles, speeds, strict=True):
        axes.plot([angle, angle], [0.0, speed], color=_BLUE, alpha=0.25, linewidth=1.0)
    axes.scatter(angles, speeds, s=sizes, color=_BLUE, alpha=0.75, zorder=3)
    if len(actions) > _MOST_LABELS:
        return
    for number, (angle, speed) in enumerate(zip(angles, speeds, strict=True)):
        axes.annotate(
            str(number),
            (angle, speed),
            xytext=(0, 7),
            textcoords="offset points",
            ha="center",
            color=INK,
            fontsize=9,
        )


def _draw_ranges(
    axes: "Axes", low: tuple[float, float], high: tuple[float, float], parts: int = 60
) -> None:
    turn = [math.radians(low[0] + (high[0] - low[0]) * k / parts) for k in range(parts + 1)]
    axes.fill_between(turn, low[1], high[1], color=_BLUE, alpha=0.35)


def _ticks(widest: float) -> list[float]:
    step = 10.0 if widest <= 30.0 else 15.0
    count = math.floor(widest / step)
    return [step * k for k in range(-count, count + 1)]


def _angle(angle: float) -> str:
    side = "L" if angle > 0 else "R" if angle < 0 else ""
    return f"{abs(angle):g}°{side}"

"""Shows action spaces."""

import math
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, counted, fitted, indented

if TYPE_CHECKING:
    from drcli.models.action_space_change import ActionSpaceReport

_WIDEST, _NARROWEST = 61, 31
_SPREAD = 2.0
"""A car steers by 30 degrees only."""

_ASPECT = 0.5
_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"


@fitted
def actions(columns: int, report: "ActionSpaceReport") -> RenderableType:
    parts: list[RenderableType] = [Text(line) for line in picture(report, columns)]
    parts.append(Text(""))
    if report.low and report.high:
        (left, slow), (right, fast) = report.low, report.high
        text = (
            f"Continuous: steering {left:g} to {right:g} degrees, speed {slow:g} to {fast:g} m/s."
        )
        parts.append(Text(text))
    else:
        known = any(action.share is not None for action in report.actions)
        heads = ("action", "steering", "speed", *(("share",) if known else ()))
        rows = [
            (
                str(number),
                f"{action.steering_angle:g}°",
                f"{action.speed:g} m/s",
                *((f"{action.share or 0:.0%}",) if known else ()),
            )
            for number, action in enumerate(report.actions)
        ]
        parts.append(Rows(heads, rows))
        parts.append(Text(f"{counted(len(report.actions), 'action')}."))
    parts += [Text(sentence) for sentence in report.notes]
    if report.picture:
        parts.append(Text.assemble("Picture: ", (report.picture, "bold")))
    if report.written:
        kept = f"; the old file is {report.backup}" if report.backup else ""
        parts.append(Text(f"Written to {report.file}{kept}."))
    elif not report.changes:
        parts.append(indented(Text(f"{report.file} has these actions.", style="dim")))
    return Group(*parts)


def picture(report: "ActionSpaceReport", columns: int) -> list[str]:
    """Steering is the direction, speed the distance from the bottom."""
    wide = max(min(_WIDEST, columns - 2), _NARROWEST)
    if wide % 2 == 0:
        wide -= 1
    if report.low and report.high:
        corners = [report.low, report.high]
    else:
        corners = [(action.steering_angle, action.speed) for action in report.actions]
    fastest = max((speed for _, speed in corners), default=1.0)
    widest = max(30.0, *(abs(angle) for angle, _ in corners)) * _SPREAD
    reach = wide // 2 / max(math.sin(math.radians(min(widest, 90.0))), 0.1)
    high = round(reach * _ASPECT)
    grid = [[" "] * wide for _ in range(high + 1)]

    def put(angle: float, speed: float, mark: str) -> None:
        turn = math.radians(angle * _SPREAD)
        column = round(wide // 2 - reach * speed / fastest * math.sin(turn))
        row = round(high - reach * _ASPECT * speed / fastest * math.cos(turn))
        if 0 <= column < wide and 0 <= row <= high:
            grid[row][column] = mark if grid[row][column] in " .:" or mark != "." else "+"

    for part in (0.5, 1.0):
        for step in range(-60, 61):
            put(widest / _SPREAD * step / 60, fastest * part, ".")
    if report.low and report.high:
        for a in range(81):
            for s in range(41):
                angle = report.low[0] + (report.high[0] - report.low[0]) * a / 80
                put(angle, report.low[1] + (report.high[1] - report.low[1]) * s / 40, "#")
    for number, action in enumerate(report.actions):
        put(action.steering_angle, action.speed, _DIGITS[number] if number < 36 else "*")
    put(0.0, 0.0, "^")
    lines = ["".join(row).rstrip() for row in grid]
    side = f"left{'':{max(wide - 9, 1)}}right"
    return [
        *lines,
        side,
        f"Outer arc {fastest:g} m/s, inner arc {fastest / 2:g} m/s; angles twice as wide.",
    ]

"""The parts that pictures of rewards are made of: a map in colours, and curves along the lap."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drcli.rewards.canvas import (
    FAINT,
    GRID,
    INK,
    PAPER,
    Canvas,
    Color,
    number,
    ticks,
)
from drcli.rewards.track_grid import Field
from drsim.track.track import Track

Floats = NDArray[np.float64]

_BAR_PX, _BAR_LABELS_PX = 18, 74
"""Width of the bar that explains the colours, and of its numbers."""

_LEGEND_PX = 24
_AXIS_PX = 62
_MARKS = (0.25, 0.5, 0.75)
"""Places on the lap that the map and the curves have in common."""

_BARE: Color = (205, 207, 209)
"""Where a function was not asked."""

_OBSTACLE: Color = (250, 250, 250)


@dataclass(frozen=True)
class Box:
    """A part of a picture, in pixels from its top left."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Its right edge."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Its lower edge."""
        return self.top + self.height


@dataclass(frozen=True)
class Scale:
    """What colours mean.

    Attributes:
        low: Value of the first colour.
        high: Value of the last.
        colors: From shares, 0 .. 1, to colours.
    """

    low: float
    high: float
    colors: Callable[[Floats], NDArray[np.uint8]]

    def of(self, values: Floats) -> NDArray[np.uint8]:
        """Colours of values. Shape (..., 3)."""
        span = self.high - self.low
        share = (values - self.low) / span if span > 0 else np.full(values.shape, 0.5)
        return self.colors(np.asarray(share, np.float64))


@dataclass(frozen=True)
class Curve:
    """A line along the lap.

    Attributes:
        name: For the legend.
        color: Of the line.
        progress: Percent of the lap. Shape (n,).
        values: NaN where there is none. Shape (n,).
    """

    name: str
    color: Color
    progress: Floats
    values: Floats


def height_of_map(track: Track, width: float) -> float:
    """How high a map of that width wants to be."""
    low_x, low_y, high_x, high_y = track.bounds
    margin_m = _margin_m(track)
    shape = (high_y - low_y + 2 * margin_m) / (high_x - low_x + 2 * margin_m)
    return float(np.clip((width - _BAR_PX - _BAR_LABELS_PX) * shape, 0.3 * width, 0.62 * width))


def draw_map(
    canvas: Canvas,
    box: Box,
    track: Track,
    field: Field,
    values: Floats,
    scale: Scale,
    start_fraction: float,
) -> None:
    """The track, each place in the colour of its value, and a bar that explains the colours.

    Args:
        canvas: Where to draw.
        box: In which part.
        track: The track as it is driven.
        field: The places.
        values: NaN where there is none. Shape (offsets, n).
        scale: The colours.
        start_fraction: Where the lap begins.
    """
    inner = Box(box.left, box.top, box.width - _BAR_PX - _BAR_LABELS_PX, box.height)
    place = _projection(track, inner)
    colors = np.where(np.isnan(values)[..., None], _BARE, scale.of(np.nan_to_num(values)))
    edges = _edges(field.xy)
    count = field.xy.shape[1]
    last = count if track.closed else count - 1
    # From the outside in: where stretches of the track lie close together, the road is on top.
    for k in sorted(range(len(values)), key=lambda k: -abs(k - len(values) // 2)):
        inside, outside = place(edges[k]), place(edges[k + 1])
        for j in range(last):
            after = (j + 1) % count
            corners = np.array([inside[j], inside[after], outside[after], outside[j]])
            red, green, blue = colors[k, j].tolist()
            canvas.area(corners, (red, green, blue))
    for border in (track.inner, track.outer):
        canvas.line(place(border), PAPER, 3.5)
        canvas.line(place(border), INK, 1.2)
    for outline in field.objects:
        canvas.area(place(outline), INK)
        canvas.area(
            place(outline.mean(axis=0) + 0.72 * (outline - outline.mean(axis=0))), _OBSTACLE
        )
    _draw_marks(canvas, track, place, start_fraction)
    _draw_bar(canvas, Box(inner.right + 12, box.top + 14, _BAR_PX, box.height - 28), scale)


def draw_curves(
    canvas: Canvas, box: Box, curves: Sequence[Curve], title: str, *, low: float, high: float
) -> None:
    """Lines over the progress of the lap, with a legend above.

    Args:
        canvas: Where to draw.
        box: In which part.
        curves: The lines.
        title: What the values are.
        low: Least value shown.
        high: Greatest value shown; what lies beyond is cut.
    """
    rows = _draw_legend(canvas, box, curves, title)
    head = _LEGEND_PX * (rows + 1)
    plot = Box(
        box.left + _AXIS_PX, box.top + head, box.width - _AXIS_PX - 8, box.height - head - 44
    )
    span = high - low or 1.0
    low, high = low - 0.04 * span, high + 0.04 * span

    def at(progress: Floats, values: Floats) -> Floats:
        x = plot.left + plot.width * np.clip(progress, 0.0, 100.0) / 100.0
        y = plot.bottom - plot.height * (np.clip(values, low, high) - low) / (high - low)
        return np.stack([x, y], axis=-1)

    for value in ticks(low, high):
        [(_, y)] = at(np.zeros(1), np.array([value]))
        canvas.line([(plot.left, y), (plot.right, y)], FAINT if value == 0 else GRID, 1)
        canvas.text(plot.left - 8, y, number(value), size=13, color=FAINT, anchor="rm")
    for percent in range(0, 101, 25):
        [(x, _)] = at(np.array([float(percent)]), np.array([low]))
        canvas.line([(x, plot.top), (x, plot.bottom)], GRID, 1)
        canvas.text(x, plot.bottom + 8, f"{percent} %", size=13, color=FAINT, anchor="ma")
    canvas.text(
        (plot.left + plot.right) / 2, box.bottom, "progress", size=13, color=FAINT, anchor="ms"
    )
    for curve in reversed(curves):
        for part in _whole_parts(curve):
            canvas.line(at(curve.progress[part], curve.values[part]), curve.color, 2)


def _draw_legend(canvas: Canvas, box: Box, curves: Sequence[Curve], title: str) -> int:
    """A title and the names of the lines below it; says how many rows of names there are."""
    canvas.text(box.left, box.top, title, size=15)
    x, y, rows = box.left, box.top + _LEGEND_PX, 1
    for curve in curves:
        width = canvas.width_of(curve.name, 13) + 44
        if x + width > box.right and x > box.left:
            x, y, rows = box.left, y + _LEGEND_PX, rows + 1
        canvas.line([(x, y + 8), (x + 20, y + 8)], curve.color, 3)
        canvas.text(x + 26, y, curve.name, size=13)
        x += width
    return rows


def _draw_marks(
    canvas: Canvas, track: Track, place: Callable[[Floats], Floats], start_fraction: float
) -> None:
    """The start, the driving direction, and quarters of the lap."""
    for fraction in (0.0, *_MARKS):
        along_m = np.array([(start_fraction + fraction) % 1.0 * track.length_m])
        x, y, yaw_rad = track.pose_at(along_m)[0].tolist()
        width_m = float(track.locate(np.array([[x, y]])).track_width_m[0])
        ahead = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        left = np.array([-ahead[1], ahead[0]])
        here = np.array([x, y])
        outward = left if _is_outside(track, here + 0.6 * width_m * left) else -left
        bar = here + width_m * np.array([[-0.5], [0.5]]) * left
        canvas.line(place(bar), PAPER, 5 if fraction == 0.0 else 2)
        canvas.line(place(bar), INK, 2.5 if fraction == 0.0 else 1)
        if fraction == 0.0:
            tip, tail = here + 0.55 * ahead, here + 0.2 * ahead
            arrow = np.array([tip, tail + 0.16 * left, tail - 0.16 * left])
            canvas.area(place(arrow), PAPER, INK)
        [(text_x, text_y)] = place((here + 1.08 * width_m * outward)[None])
        name = "start" if fraction == 0.0 else f"{fraction:.0%}".replace("%", " %")
        canvas.text(text_x, text_y, name, size=13, color=INK, anchor="mm", halo=True)


def _draw_bar(canvas: Canvas, box: Box, scale: Scale) -> None:
    steps = 64
    colors = scale.colors(np.linspace(1.0, 0.0, steps))
    for k, (red, green, blue) in enumerate(colors.tolist()):
        top, bottom = (box.top + box.height * part / steps for part in (k, k + 1))
        corners = [(box.left, top), (box.right, top), (box.right, bottom), (box.left, bottom)]
        canvas.area(corners, (red, green, blue))
    span = scale.high - scale.low
    for value in ticks(scale.low, scale.high, 6) if span > 0 else [scale.low]:
        share = (value - scale.low) / span if span > 0 else 0.5
        y = box.bottom - box.height * share
        canvas.line([(box.right, y), (box.right + 5, y)], INK, 1)
        canvas.text(box.right + 9, y, number(value), size=13, anchor="lm")


def _margin_m(track: Track) -> float:
    """Room around the road for what lies beside it, and for the marks."""
    return 0.9 * float(np.hypot(*(track.outer - track.inner).T).max())


def _projection(track: Track, box: Box) -> Callable[[Floats], Floats]:
    """From metres to pixels, the same in both directions, centred in the box."""
    low_x, low_y, high_x, high_y = track.bounds
    margin_m = _margin_m(track)
    width_m, height_m = high_x - low_x + 2 * margin_m, high_y - low_y + 2 * margin_m
    pixels = min(box.width / width_m, box.height / height_m)
    center_x, center_y = (low_x + high_x) / 2, (low_y + high_y) / 2

    def place(xy: Floats) -> Floats:
        x = box.left + box.width / 2 + (xy[..., 0] - center_x) * pixels
        y = box.top + box.height / 2 - (xy[..., 1] - center_y) * pixels
        return np.stack([x, y], axis=-1)

    return place


def _edges(xy: Floats) -> Floats:
    """Lines midway between rows of places, and beyond the outermost. Shape (rows + 1, n, 2)."""
    between = (xy[:-1] + xy[1:]) / 2
    first, last = 2 * xy[:1] - between[:1], 2 * xy[-1:] - between[-1:]
    return np.concatenate([first, between, last])


def _is_outside(track: Track, point: Floats) -> bool:
    """Whether a point beside the road lies on the side of the outer border."""
    return bool(np.hypot(*(track.outer - point).T).min() < np.hypot(*(track.inner - point).T).min())


def _whole_parts(curve: Curve) -> list[slice]:
    """Stretches of a curve without holes and jumps, as when a car is put back on the road."""
    bad = np.isnan(curve.values)
    steps = np.diff(curve.progress)
    far = 6.0 * np.median(np.abs(steps)) + 1.0 if len(steps) else 0.0
    jumps = np.flatnonzero(np.abs(steps) > far) + 1
    edges = [0, *sorted({*np.flatnonzero(bad).tolist(), *jumps.tolist()}), len(curve.values)]
    parts = []
    for begin, end in itertools.pairwise(edges):
        first = begin + 1 if begin < len(bad) and bad[begin] else begin
        if end - first > 1:
            parts.append(slice(first, end))
    return parts

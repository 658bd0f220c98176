"""Small maps of a track: in the letters of a terminal, and as a picture."""

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drsim.track.track import Track

Floats = NDArray[np.float64]
Axis = NDArray[np.floating[Any]]
Picture = NDArray[np.uint8]

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bits of the dots of a braille letter, four rows of two."""

_BRAILLE = 0x2800
_ARROWS = "→↗↑↖←↙↓↘"
_ARROWS_AT = (0.125, 0.375, 0.625, 0.875)
_LETTER_ASPECT = 2.0
"""Height of a terminal's letter over its width."""

_FIELD, _ROAD, _LINE, _START = (226, 232, 220), (52, 60, 70), (240, 150, 20), (255, 255, 255)
_MARGIN_M = 0.4


def text_map(track: Track, columns: int = 78, rows: int = 16) -> list[str]:
    """A map of braille dots: S is the start, arrows show the driving direction.

    Args:
        track: The track.
        columns: Most letters in a line.
        rows: Most lines.

    Returns:
        Lines, the first at the top; the map keeps its proportions.
    """
    low_x, low_y, high_x, high_y = track.bounds
    width_m, height_m = high_x - low_x, high_y - low_y
    letter_m = max(width_m / columns, height_m / rows / _LETTER_ASPECT, 1e-9)
    columns = max(math.ceil(width_m / letter_m), 1)
    rows = max(math.ceil(height_m / letter_m / _LETTER_ASPECT), 1)
    x = low_x + letter_m / 2 * (np.arange(2 * columns) + 0.5)
    y = high_y - letter_m * _LETTER_ASPECT / 4 * (np.arange(4 * rows) + 0.5)
    dots = track.on_road(np.stack(np.meshgrid(x, y), axis=-1)).reshape(rows, 4, columns, 2)
    bits = (dots * _DOTS[None, :, None, :]).sum(axis=(1, 3))
    letters = [[chr(_BRAILLE + int(bit)) for bit in line] for line in bits]

    def put(fraction: float, letter: str | None) -> None:
        place_x, place_y, yaw_rad = track.pose_at(np.array([fraction * track.length_m]))[0]
        column = min(int((place_x - low_x) / letter_m), columns - 1)
        row = min(int((high_y - place_y) / letter_m / _LETTER_ASPECT), rows - 1)
        letters[row][column] = letter or _ARROWS[round(yaw_rad / (math.pi / 4)) % 8]

    for fraction in _ARROWS_AT:
        put(fraction, None)
    put(0.0, "S")
    return ["".join(line).replace(chr(_BRAILLE), " ").rstrip() for line in letters]


def picture_map(track: Track, width_px: int = 800) -> Picture:
    """A picture: road, centre line, the start as a white bar and the direction as arrow heads.

    Args:
        track: The track.
        width_px: Width of the picture; very high tracks get a narrower one.

    Returns:
        RGB, shape (rows, columns, 3).
    """
    low_x, low_y, high_x, high_y = track.bounds
    width_m, height_m = high_x - low_x + 2 * _MARGIN_M, high_y - low_y + 2 * _MARGIN_M
    pixel_m = max(width_m, height_m) / width_px
    columns, rows = math.ceil(width_m / pixel_m), math.ceil(height_m / pixel_m)
    # Twice as many points a side, averaged afterwards, make smooth edges.
    half_m = pixel_m / 2
    x = low_x - _MARGIN_M + half_m * (np.arange(2 * columns) + 0.5)
    y = high_y + _MARGIN_M - half_m * (np.arange(2 * rows) + 0.5)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    picture = np.where(_on_road(track, x, y)[..., None], _ROAD, _FIELD).astype(np.float64)

    def paint(xy: Floats, radius_m: float, color: tuple[int, int, int]) -> None:
        """Dots of a colour."""
        reach = max(math.ceil(radius_m / half_m), 1)
        for dot in xy:
            column = int((dot[0] - x[0]) / half_m)
            row = int((y[0] - dot[1]) / half_m)
            window = (
                slice(max(row - reach, 0), max(row + reach + 2, 0)),
                slice(max(column - reach, 0), max(column + reach + 2, 0)),
            )
            near = np.hypot(*np.moveaxis(points[window] - dot, -1, 0)) <= radius_m
            picture[window][near] = color

    dash_m = np.arange(0.0, track.length_m, max(4 * pixel_m, track.length_m / 400))
    paint(track.pose_at(dash_m)[:, :2], max(0.02, pixel_m * 0.8), _LINE)
    where = track.locate(track.center[:1])
    bar_m = np.linspace(-0.5, 0.5, 60) * float(where.track_width_m[0])
    start = track.pose_at(np.zeros(1))[0]
    across = np.array([-math.sin(start[2]), math.cos(start[2])])
    paint(start[:2] + bar_m[:, None] * across, max(0.05, 1.5 * pixel_m), _START)
    size_m = max(0.16, 7 * pixel_m)
    first = max(0.02, 2.5 * size_m / track.length_m)  # clear of the bar
    for fraction in (first, *_ARROWS_AT):
        paint(_arrow(track, fraction, size_m), max(0.02, pixel_m), _START)
    small = np.round(picture.reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3)))
    whole: Picture = small.astype(np.uint8)
    return whole


def _on_road(track: Track, x: Axis, y: Axis) -> NDArray[np.bool_]:
    """Whether the points of an even grid lie on the road, line by line of the grid.

    `Track.on_road` answers for any points; for the millions of a picture it takes seconds.

    Args:
        track: The track.
        x: Increasing. Shape (columns,).
        y: Decreasing. Shape (rows,).

    Returns:
        Answers. Shape (rows, columns).
    """
    if not track.closed:
        return _inside(np.concatenate([track.outer, track.inner[::-1], track.outer[:1]]), x, y)
    return _inside(track.outer, x, y) & ~_inside(track.inner, x, y)


def _inside(ring: Floats, x: Axis, y: Axis) -> NDArray[np.bool_]:
    """Whether the points of a grid lie inside a ring: left of an odd number of its sides."""
    passed = np.zeros((len(y), len(x) + 1), dtype=np.int64)
    for start, end in itertools.pairwise(ring):
        high, low = max(start[1], end[1]), min(start[1], end[1])
        rows = np.arange(*np.searchsorted(-y, [-high, -low]))
        share = (y[rows] - start[1]) / (end[1] - start[1]) if len(rows) else rows
        columns = np.searchsorted(x, start[0] + share * (end[0] - start[0]))
        passed[rows, columns] += 1  # one entry a row: each side crosses a row once
    odd: NDArray[np.bool_] = passed.cumsum(axis=1)[:, :-1] % 2 == 1
    return odd


def _arrow(track: Track, fraction: float, size_m: float) -> Floats:
    """Points of an arrow head that looks along the track. Shape (k, 2)."""
    x, y, yaw_rad = track.pose_at(np.array([fraction * track.length_m]))[0]
    side = np.linspace(-1.0, 1.0, 41)
    along, across = -np.abs(side) * size_m, side * size_m
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.stack([x + cos * along - sin * across, y + sin * along + cos * across], axis=1)

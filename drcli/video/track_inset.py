"""The small map in a video, with the car's trail."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from drsim.track.track import Track

Floats = NDArray[np.float64]
RGB = tuple[int, int, int]

_ROAD, _EDGE, _START = (62, 68, 80, 235), (205, 210, 218, 255), (255, 255, 255, 255)
_FINE = 3
"""Drawn larger and shrunk, for smooth edges."""

_SPEEDS = ((58, 82, 230), (38, 176, 212), (80, 200, 96), (250, 196, 40), (236, 72, 48))


def speed_color(share: float) -> RGB:
    place = min(max(share, 0.0), 1.0) * (len(_SPEEDS) - 1)
    first = min(int(place), len(_SPEEDS) - 2)
    part = place - first
    red, green, blue = (
        round(a + part * (b - a)) for a, b in zip(_SPEEDS[first], _SPEEDS[first + 1], strict=True)
    )
    return red, green, blue


class TrackInset:
    def __init__(self, track: Track, box_px: tuple[int, int]) -> None:
        """`box_px` is the greatest width and height."""
        low_x, low_y, high_x, high_y = track.bounds
        margin = 0.03 * max(high_x - low_x, high_y - low_y) + 0.2
        width_m, height_m = high_x - low_x + 2 * margin, high_y - low_y + 2 * margin
        self._scale = min(box_px[0] / width_m, box_px[1] / height_m)
        self._corner = (low_x - margin, high_y + margin)
        self.size = (max(1, round(width_m * self._scale)), max(1, round(height_m * self._scale)))
        fine = Image.new("RGBA", (self.size[0] * _FINE, self.size[1] * _FINE), (0, 0, 0, 0))
        draw = ImageDraw.Draw(fine)
        rings = [track.outer, track.inner]
        if track.closed:
            # The inner ring is cut out of the outer one, whichever encloses the other.
            areas = [abs(_area(ring)) for ring in rings]
            outer, inner = (rings[0], rings[1]) if areas[0] >= areas[1] else (rings[1], rings[0])
            draw.polygon(self._fine(outer), fill=_ROAD)
            draw.polygon(self._fine(inner), fill=(0, 0, 0, 0))
        else:
            draw.polygon(self._fine(np.concatenate([rings[0], rings[1][::-1]])), fill=_ROAD)
        for ring in rings:
            draw.line(self._fine(ring), fill=_EDGE, width=_FINE)
        draw.line(
            self._fine(np.stack([track.inner[0], track.outer[0]])), fill=_START, width=2 * _FINE
        )
        self._road = fine
        self._base = fine.resize(self.size, Image.Resampling.BOX)
        self._last: tuple[float, float] | None = None

    def wipe(self) -> None:
        self._base = self._road.resize(self.size, Image.Resampling.BOX)
        self._last = None

    def trail(self, xy: tuple[float, float], share: float) -> None:
        """`share` is of the film's fastest speed."""
        here = self._at(xy)
        if self._last is not None and math.dist(here, self._last) < 0.25 * max(self.size):
            draw = ImageDraw.Draw(self._base)
            draw.line([self._last, here], fill=(*speed_color(share), 255), width=2)
        self._last = here

    def picture(
        self,
        marks: Sequence[tuple[tuple[float, float], RGB, float]],
    ) -> Image.Image:
        """RGBA; `marks` are places, colours and radii in pixels."""
        picture = self._base.copy()
        draw = ImageDraw.Draw(picture)
        for xy, color, radius in marks:
            x, y = self._at(xy)
            box = (x - radius, y - radius, x + radius, y + radius)
            draw.ellipse(
                box, fill=(*color, 255), outline=(255, 255, 255, 255) if radius > 3 else None
            )
        return picture

    def _at(self, xy: tuple[float, float]) -> tuple[float, float]:
        left, top = self._corner
        return (xy[0] - left) * self._scale, (top - xy[1]) * self._scale

    def _fine(self, line: Floats) -> list[tuple[float, float]]:
        return [(_FINE * x, _FINE * y) for x, y in (self._at((a, b)) for a, b in line.tolist())]


def _area(ring: Floats) -> float:
    x, y = (ring - ring[0]).T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))

"""A picture to draw on: lines, areas and text with smooth edges, written as PNG."""

import io
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError

Floats = NDArray[np.float64]
Color = tuple[int, int, int]

PAPER: Color = (252, 252, 250)
INK: Color = (38, 42, 48)
FAINT: Color = (120, 126, 134)
GRID: Color = (226, 228, 230)

LINES: tuple[Color, ...] = (
    (31, 119, 180),
    (214, 86, 20),
    (30, 140, 80),
    (150, 70, 170),
    (120, 90, 60),
    (90, 90, 90),
)
"""Colours of lines, told apart by colour-blind people as far as their lightness differs."""

_SEQUENTIAL = np.array(
    [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ],
    np.float64,
)
"""From little to much: even steps of lightness, also in grey. The colours are those of viridis."""

_DIVERGING = np.array(
    [[33, 102, 172], [146, 197, 222], [245, 245, 242], [244, 165, 130], [178, 24, 43]], np.float64
)
"""From less over equal to more."""

_SHARPNESS = 2
"""How many times as many pixels a side are drawn as are written: edges get smooth."""

_PNG = b"\x89PNG\r\n\x1a\n"
"""How every such picture begins."""


class Canvas:
    """A picture of a size in pixels, the origin at the top left.

    Args:
        width: Columns.
        height: Rows.
    """

    def __init__(self, width: int, height: int) -> None:
        self._image = Image.new("RGB", (width * _SHARPNESS, height * _SHARPNESS), PAPER)
        self._draw = ImageDraw.Draw(self._image)

    def line(
        self, points: Floats | Sequence[tuple[float, float]], color: Color, width: float = 1.0
    ) -> None:
        """A line through points. Shape (n, 2)."""
        thick = max(round(width * _SHARPNESS), 1)
        self._draw.line(_pixels(points), fill=color, width=thick, joint="curve")

    def area(
        self,
        corners: Floats | Sequence[tuple[float, float]],
        fill: Color,
        outline: Color | None = None,
    ) -> None:
        """A filled polygon. Shape (n, 2)."""
        self._draw.polygon(_pixels(corners), fill=fill, outline=outline)

    def dot(self, x: float, y: float, radius: float, color: Color) -> None:
        """A filled circle."""
        box = [(x - radius, y - radius), (x + radius, y + radius)]
        self._draw.ellipse(_pixels(box), fill=color)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 15,
        color: Color = INK,
        anchor: str = "la",
        halo: bool = False,
    ) -> None:
        """A line of text.

        Args:
            x: Of the anchor.
            y: Likewise.
            text: What to write.
            size: Height of the letters in pixels.
            color: Their colour.
            anchor: Which point of the text x and y are: l, m, r and a (top), m, s (base line).
            halo: Draw a rim of paper around the letters.
        """
        self._draw.text(
            (x * _SHARPNESS, y * _SHARPNESS),
            text,
            fill=color,
            font=_font(size),
            anchor=anchor,
            stroke_width=2 * _SHARPNESS if halo else 0,
            stroke_fill=PAPER,
        )

    def width_of(self, text: str, size: float = 15) -> float:
        """Pixels that a line of text takes."""
        return float(_font(size).getlength(text)) / _SHARPNESS

    def save(self, path: Path) -> None:
        """Write it.

        Raises:
            SettingsError: There is no such folder, or it cannot be written to; a picture that was
                there before is as it was.
        """
        data = io.BytesIO()
        self._image.reduce(_SHARPNESS).save(data, format="PNG", optimize=True)
        rewrite(path, data.getvalue())


def refuse_replacing(path: Path) -> None:
    """Refuse to draw over a file that is no picture of this kind, or where there is no folder.

    Raises:
        SettingsError: It is one, or there is none.
    """
    if not path.parent.is_dir():
        raise SettingsError(
            f"{path} cannot be written: there is no folder {path.parent}.",
            remedy="Name a file in a folder that exists and is yours.",
        )
    try:
        with path.open("rb") as file:
            start = file.read(len(_PNG))
    except FileNotFoundError:
        return
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be written: {error.strerror or error}.",
            remedy="Name a file in a folder that exists and is yours.",
        ) from None
    if start and start != _PNG:
        raise SettingsError(
            f"{path} is there already and no PNG picture, so it is not replaced.",
            remedy="Name another file with --out, such as --out rewards.png.",
        )


def sequential(share: Floats) -> NDArray[np.uint8]:
    """Colours from little (0) to much (1). Shape (..., 3)."""
    return _blend(_SEQUENTIAL, share)


def diverging(share: Floats) -> NDArray[np.uint8]:
    """Colours from less (-1) over equal (0) to more (1). Shape (..., 3)."""
    return _blend(_DIVERGING, (share + 1) / 2)


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About so many round numbers from low to high."""
    span = high - low
    if span <= 0 or not math.isfinite(span):
        return [low]
    rough = span / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * k for k in (1, 2, 2.5, 5, 10) if power * k >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [step * k for k in range(first, last + 1)]


def number(value: float) -> str:
    """A short number."""
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    return f"{value:.2g}"


@cache
def _font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size * _SHARPNESS)


def _pixels(points: Floats | Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    return [(float(x) * _SHARPNESS, float(y) * _SHARPNESS) for x, y in points]


def _blend(colors: Floats, share: Floats) -> NDArray[np.uint8]:
    places = np.linspace(0.0, 1.0, len(colors))
    mixed = np.stack([np.interp(share, places, channel) for channel in colors.T], axis=-1)
    blended: NDArray[np.uint8] = np.round(mixed).astype(np.uint8)
    return blended

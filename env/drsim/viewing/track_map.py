"""Small maps of a track: in the letters of a terminal, and as a picture."""

import io
import math

import numpy as np
from PIL import Image, ImageDraw

from drsim.arrays import Bytes, Floats
from drsim.track.track import Track

RGB = tuple[int, int, int]

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_BRAILLE = 0x2800
_ARROWS = "→↗↑↖←↙↓↘"
_ARROWS_AT = (0.125, 0.375, 0.625, 0.875)
_LETTER_ASPECT = 2.0
_FIELD, _ROAD, _LINE, _START = (226, 232, 220), (52, 60, 70), (240, 150, 20), (255, 255, 255)
_MARGIN_M = 0.4


def text_map(track: Track, columns: int = 78, rows: int = 16) -> list[str]:
    """A map of braille dots: S is the start, arrows show the driving direction."""
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


def picture_map(track: Track, width_px: int = 800, line: Floats | None = None) -> Bytes:
    """Road, dashed centre line, the start as a white bar, the direction as arrow heads.

    A `line` of x, y and speed, (n, 3), goes from red (slow) to green. RGB.
    """
    low_x, low_y, high_x, high_y = track.bounds
    width_m, height_m = high_x - low_x + 2 * _MARGIN_M, high_y - low_y + 2 * _MARGIN_M
    pixel_m = max(width_m, height_m) / width_px
    columns, rows = math.ceil(width_m / pixel_m), math.ceil(height_m / pixel_m)
    # Drawn at twice the size and shrunk, edges become smooth.
    fine_m = pixel_m / 2
    image = Image.new("RGB", (2 * columns, 2 * rows), _FIELD)
    draw = ImageDraw.Draw(image)

    def pixels(xy: Floats) -> list[tuple[float, float]]:
        corner = (low_x - _MARGIN_M, high_y + _MARGIN_M)
        return [(x, y) for x, y in ((xy - corner) * (1, -1) / fine_m - 0.5).tolist()]

    def dots(xy: Floats, radius_m: float, color: RGB) -> None:
        reach = max(radius_m / fine_m, 1.0)
        for x, y in pixels(xy):
            draw.ellipse((x - reach, y - reach, x + reach, y + reach), fill=color)

    if track.closed:
        draw.polygon(pixels(track.outer), fill=_ROAD)
        draw.polygon(pixels(track.inner), fill=_FIELD)
    else:
        draw.polygon(pixels(np.concatenate([track.outer, track.inner[::-1]])), fill=_ROAD)
    dash_m = np.arange(0.0, track.length_m, max(4 * pixel_m, track.length_m / 400))
    dots(track.pose_at(dash_m)[:, :2], max(0.02, pixel_m * 0.8), _LINE)
    bar_m = np.linspace(-0.5, 0.5, 60) * float(track.locate(track.center[:1]).track_width_m[0])
    start = track.pose_at(np.zeros(1))[0]
    across = np.array([-math.sin(start[2]), math.cos(start[2])])
    dots(start[:2] + bar_m[:, None] * across, max(0.05, 1.5 * pixel_m), _START)
    size_m = max(0.16, 7 * pixel_m)
    first = max(0.02, 2.5 * size_m / track.length_m)  # clear of the bar
    for fraction in (first, *_ARROWS_AT):
        dots(_arrow(track, fraction, size_m), max(0.02, pixel_m), _START)
    if line is not None:
        low, high = line[:, 2].min(), line[:, 2].max()
        fast = (line[:, 2] - low) / max(high - low, 1e-9)
        ends = pixels(line[:, :2])
        width = max(round(max(0.04 / fine_m, 5.0)), 1)
        for here, there, share in zip(ends, [*ends[1:], ends[0]], fast.tolist(), strict=True):
            draw.line([here, there], fill=_paint(share), width=width)
    return np.asarray(image.resize((columns, rows), Image.Resampling.BOX))


def _paint(share: float) -> RGB:
    return (round(230 * min(1.0, 2.0 - 2.0 * share)), round(210 * min(1.0, 2.0 * share)), 40)


def png_bytes(picture: Bytes) -> bytes:
    """Of a grey (rows, columns) or RGB (rows, columns, 3) picture."""
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG", optimize=True)
    return file.getvalue()


def _arrow(track: Track, fraction: float, size_m: float) -> Floats:
    x, y, yaw_rad = track.pose_at(np.array([fraction * track.length_m]))[0]
    side = np.linspace(-1.0, 1.0, 41)
    along, across = -np.abs(side) * size_m, side * size_m
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.stack([x + cos * along - sin * across, y + sin * along + cos * across], axis=1)

"""What lies around a track in pictures for people: sky, clouds, hills and woods."""

import math
import zlib
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import RGB, Bytes, Floats, Singles
from drsim.jit import kernel

COLUMNS, ROWS = 4096, 384
STEEPEST = 0.55
ZENITH, HORIZON = (70.0, 128.0, 205.0), (208.0, 224.0, 238.0)
HAZE = (186.0, 205.0, 214.0)
HAZE_M = 70.0
"""Ground takes on 63 % of that colour."""

_CLOUD, _CLOUD_SHADE = (252.0, 252.0, 252.0), (196.0, 206.0, 220.0)
_RANGES: tuple[tuple[float, float, int, tuple[float, float, float]], ...] = (
    (0.030, 0.060, 5, (150.0, 176.0, 198.0)),
    (0.020, 0.038, 9, (118.0, 150.0, 150.0)),
    (0.010, 0.020, 17, (92.0, 128.0, 92.0)),
)
"""Furthest first: least height, rise, waves around, colour."""

_WOODS = (58.0, 92.0, 52.0)
_SUN_AZIMUTH_RAD = -0.2
_TILE, _COPIES = 1024, 8
_GRAINS = (0.9, 0.8, 0.6, 0.5, 0.5, 0.5, 0.4)


@lru_cache(maxsize=2)
def landscape_of(world: str) -> Bytes:
    """The first row is the highest; 0.4 s. Shared: do not write."""
    random = np.random.default_rng(zlib.crc32(world.encode()) ^ 0x5CE4E)
    height = np.linspace(STEEPEST, 0.0, ROWS)[:, None]
    azimuth = np.linspace(0.0, 2.0 * np.pi, COLUMNS, endpoint=False)
    rise = 1.0 - np.exp(-height / 0.22)
    low, top = np.array(HORIZON), np.array(ZENITH)
    picture = (low + rise[:, :, None] * (top - low)) * np.ones((1, COLUMNS, 1))
    turn = (azimuth - _SUN_AZIMUTH_RAD + np.pi) % (2.0 * np.pi) - np.pi
    glow = np.exp(-((turn / 0.9) ** 2))[None, :] * np.exp(-height / 0.45)
    picture += glow[:, :, None] * np.array([34.0, 22.0, 0.0])
    _add_clouds(picture, height, random)
    pixel = STEEPEST / (ROWS - 1)
    for least, more, waves, color in _RANGES:
        line = least + more * _ridge(azimuth, waves, random)
        _cover(picture, height, line, np.array(color), pixel, light=10.0)
    trees = 0.006 + 0.016 * _treetops(random)
    _cover(picture, height, trees, np.array(_WOODS), pixel, light=26.0)
    return np.asarray(np.clip(np.rint(picture), 0, 255).astype(np.uint8))


@lru_cache(maxsize=2)
def grain_of(world: str) -> Singles:
    """Shared: do not write."""
    random = np.random.default_rng(zlib.crc32(world.encode()) ^ 0x6A417)
    tile = np.zeros((_TILE, _TILE))
    for octave, strength in enumerate(_GRAINS):
        dots = random.standard_normal((_TILE >> octave, _TILE >> octave))
        tile += strength * np.kron(_softened(dots), np.ones((1 << octave, 1 << octave)))
        tile = _softened(tile) if octave > 1 else tile
    tile /= tile.std()
    copies = np.zeros((_COPIES, _TILE, _TILE), np.float32)
    for copy in range(_COPIES):
        copies[copy, : len(tile), : len(tile)] = tile
        tile = tile.reshape(len(tile) // 2, 2, len(tile) // 2, 2).mean(axis=(1, 3))
    return copies


def _softened(dots: Floats) -> Floats:
    mean = 0.5 * dots + 0.25 * (np.roll(dots, 1, 0) + np.roll(dots, -1, 0))
    return 0.5 * mean + 0.25 * (np.roll(mean, 1, 1) + np.roll(mean, -1, 1))


def _add_clouds(picture: Floats, height: Floats, random: np.random.Generator) -> None:
    # Rows nearer to the horizon show more of the cloud layer, so its pattern is pressed together.
    rows = np.log(height[:, 0] + 0.05)
    rows = (rows - rows.min()) / np.ptp(rows) * 255.0
    pattern = _clouds(random)
    heaps = _between(pattern, rows, np.arange(COLUMNS, dtype=np.float64) * (1024.0 / COLUMNS))
    cover = np.clip((heaps - 0.52) / 0.16, 0.0, 1.0)
    cover = cover * cover * (3.0 - 2.0 * cover)
    cover *= np.clip((height - 0.05) / 0.08, 0.0, 1.0) * 0.9
    lit = np.clip(0.5 + (heaps - np.roll(heaps, -6, axis=0)) * 9.0, 0.0, 1.0)[:, :, None]
    color = np.array(_CLOUD_SHADE) + lit * (np.array(_CLOUD) - np.array(_CLOUD_SHADE))
    picture += cover[:, :, None] * (color - picture)


def _clouds(random: np.random.Generator) -> Floats:
    total, weight = np.zeros((256, 1024)), 0.0
    for octave in range(6):
        rows, columns = 4 * 2**octave, 8 * 2**octave
        dots = random.random((rows + 1, columns))
        part = 0.55**octave
        total += part * _between(
            dots,
            np.linspace(0.0, rows - 1e-3, 256),
            np.arange(1024, dtype=np.float64) * (columns / 1024.0),
        )
        weight += part
    total /= weight
    return np.asarray((total - total.min()) / np.ptp(total))


def _between(dots: Floats, rows: Floats, columns: Floats) -> Floats:
    row, column = np.floor(rows).astype(int), np.floor(columns).astype(int)
    down, right = (rows - row)[:, None], (columns - column)[None, :]
    down, right = down * down * (3.0 - 2.0 * down), right * right * (3.0 - 2.0 * right)
    last = len(dots) - 1
    row, below = np.minimum(row, last), np.minimum(row + 1, last)
    here, beside = column % dots.shape[1], (column + 1) % dots.shape[1]
    upper = dots[row][:, here] * (1.0 - right) + dots[row][:, beside] * right
    lower = dots[below][:, here] * (1.0 - right) + dots[below][:, beside] * right
    return np.asarray(upper * (1.0 - down) + lower * down)


def _ridge(azimuth: Floats, waves: int, random: np.random.Generator) -> Floats:
    line = np.zeros(len(azimuth))
    for octave in range(5):
        turn, phase = waves * 2**octave, random.uniform(0.0, 2.0 * np.pi)
        wobble = np.sin(azimuth * (turn // 2 + 1) + random.uniform(0.0, 6.28))
        line += 0.5**octave * np.sin(azimuth * turn + phase + wobble)
    return np.asarray((line - line.min()) / np.ptp(line))


def _treetops(random: np.random.Generator) -> Floats:
    line = np.zeros(COLUMNS)
    at = np.arange(COLUMNS, dtype=np.float64)
    stands = _between(random.random((1, 64)), np.zeros(1), at * (64.0 / COLUMNS))[0]
    for middle in random.uniform(0.0, COLUMNS, 900):
        radius = random.uniform(4.0, 13.0)
        away = (at - middle + COLUMNS / 2) % COLUMNS - COLUMNS / 2
        crown = np.sqrt(np.maximum(1.0 - (away / radius) ** 2, 0.0)) * (0.35 + radius / 20.0)
        line = np.maximum(line, crown)
    return np.asarray(np.clip(line * np.clip(stands * 1.7 - 0.35, 0.0, 1.0), 0.0, 1.0))


def _cover(
    picture: Floats, height: Floats, line: Floats, color: Floats, pixel: float, *, light: float
) -> None:
    lower = height[:, 0] < line.max() + pixel
    picture, height = picture[lower.argmax() :], height[lower]
    cover = np.clip(0.5 + (line - height) / pixel, 0.0, 1.0)[:, :, None]
    top = np.clip(1.0 - (line - height) / np.maximum(line, 1e-6), 0.0, 1.0)[:, :, None]
    picture += cover * (color + light * (top - 0.5) - picture)


# Paints the horizon and the barriers in the view of the world.


class Surroundings(NamedTuple):
    """What is around the track.

    Attributes:
        panorama: A column for each direction from east over north, the highest row first.
        steepest: Tangent of its greatest height.
        barriers: Inner faces: least x, greatest x, least y, greatest y.
        colors: Of barriers, light boards and haze, 0 to 255.
        haze_m: Depth in which haze makes up 63 %.
    """

    panorama: Bytes
    steepest: float
    barriers: tuple[float, float, float, float]
    barrier_m: float
    colors: tuple[RGB, RGB, RGB]
    haze_m: float


@kernel
def paint_horizon(
    around_parts: tuple[Any, ...],
    step: tuple[float, float],
    directions: Floats,
    below: Floats,
    mixed: Singles,
) -> None:
    """Paint the horizon into some rows, black where there is only ground (`below` is its share)."""
    around = Surroundings(*around_parts)
    for row in range(len(mixed)):
        ahead = (directions[row, 0], directions[row, 1], directions[row, 2])
        mixed[row] = np.float32(0.0)
        if below[row] < 1.0:
            _horizon_row(around.panorama, around.steepest, ahead, step, mixed[row])


@kernel
def paint_barriers(
    around_parts: tuple[Any, ...],
    pos: RGB,
    focal_px: float,
    step: tuple[float, float],
    directions: Floats,
    mixed: Singles,
) -> None:
    around = Surroundings(*around_parts)
    if around.barrier_m <= 0.0:
        return
    for row in range(len(mixed)):
        if directions[row, 2] < 0.05:
            ahead = (directions[row, 0], directions[row, 1], directions[row, 2])
            _barrier_row(around, pos, ahead, step, focal_px, mixed[row])


@kernel
def _horizon_row(
    panorama: Bytes, steepest: float, ahead: RGB, step: tuple[float, float], mixed: Singles
) -> None:
    rows, columns, _ = panorama.shape
    for pixel in range(len(mixed)):
        x, y = ahead[0] + pixel * step[0], ahead[1] + pixel * step[1]
        height = ahead[2] / (math.sqrt(x * x + y * y) + 1e-9)
        # Added to it, the place is positive and its whole part is cheap to find.
        across = (math.atan2(y, x) / (2.0 * math.pi) + 1.0) * columns - 0.5
        along = min(max((1.0 - height / steepest) * (rows - 1), 0.0), rows - 1.001)
        column, row = int(across), int(along)
        right, down = across - column, along - row
        here = column % columns
        beside = here + 1 if here + 1 < columns else 0
        for channel in range(3):
            upper = panorama[row, here, channel] * (1.0 - right)
            upper += panorama[row, beside, channel] * right
            lower = panorama[row + 1, here, channel] * (1.0 - right)
            lower += panorama[row + 1, beside, channel] * right
            mixed[pixel, channel] = upper + down * (lower - upper)


@kernel
def _barrier_row(
    around: Surroundings,
    pos: RGB,
    ahead: RGB,
    step: tuple[float, float],
    focal_px: float,
    mixed: Singles,
) -> None:
    low_x, high_x, low_y, high_y = around.barriers
    z = ahead[2]
    depth = pos[2] / -z if z < 0.0 else 1e9
    for pixel in range(len(mixed)):
        x, y = ahead[0] + pixel * step[0], ahead[1] + pixel * step[1]
        hit_x, hit_y = pos[0] + depth * x, pos[1] + depth * y
        if low_x < hit_x < high_x and low_y < hit_y < high_y:
            continue
        share, color = _barrier(around, pos, (x, y, z), focal_px)
        if share > 0.0:
            for channel in range(3):
                mixed[pixel, channel] += share * (color[channel] - mixed[pixel, channel])


@kernel
def _barrier(
    around: Surroundings,
    pos: RGB,
    ahead: RGB,
    focal_px: float,
) -> tuple[float, RGB]:
    low_x, high_x, low_y, high_y = around.barriers
    barrier_m = around.barrier_m
    dark, bright, haze = around.colors
    x, y, z = ahead
    depth, along, light = 1e9, 0.0, 1.0
    if x > 1e-9 and pos[0] < high_x:
        depth, light = (high_x - pos[0]) / x, 0.92
    elif x < -1e-9 and pos[0] > low_x:
        depth, light = (low_x - pos[0]) / x, 1.06
    along = pos[1] + depth * y
    other = 1e9
    if y > 1e-9 and pos[1] < high_y:
        other = (high_y - pos[1]) / y
    elif y < -1e-9 and pos[1] > low_y:
        other = (low_y - pos[1]) / y
    if other < depth:
        depth, light = other, 0.98 if y < 0.0 else 0.84
        along = pos[0] + depth * x
    if depth >= 1e8 or not (
        low_x - 0.01 <= pos[0] + depth * x <= high_x + 0.01
        and low_y - 0.01 <= pos[1] + depth * y <= high_y + 0.01
    ):
        return 0.0, haze
    pixel_m = depth / focal_px
    height = pos[2] + depth * z
    share = min(max(0.5 + (barrier_m - height) / pixel_m, 0.0), 1.0)
    share *= min(max(0.5 + height / pixel_m, 0.0), 1.0)
    if share == 0.0:
        return 0.0, haze
    # Boards of 1.6 m, every third of them light, with a light edge on top and a dark joint.
    place = along / 1.6
    part = (place - math.floor(place)) * 1.6
    mix = 1.0 if (math.floor(place) % 3) == 0 else 0.0
    edge = min(max(0.5 + (height - 0.84 * barrier_m) / pixel_m, 0.0), 1.0)
    mix = max(mix, edge)
    joint = 1.0 - 0.35 * min(max(1.0 - abs(min(part, 1.6 - part)) / max(0.012, pixel_m), 0.0), 1.0)
    foot = 0.72 + 0.28 * min(max(height / (0.6 * barrier_m), 0.0), 1.0)
    clear = math.exp(-depth / around.haze_m)
    lit = _scaled(_mixed(dark, bright, mix), light * (joint * foot))
    return share, _mixed(haze, lit, clear)


@kernel
def _scaled(color: RGB, factor: float) -> RGB:
    return color[0] * factor, color[1] * factor, color[2] * factor


@kernel
def _mixed(under: RGB, over: RGB, share: float) -> RGB:
    return (
        under[0] + share * (over[0] - under[0]),
        under[1] + share * (over[1] - under[1]),
        under[2] + share * (over[2] - under[2]),
    )

"""Paints the horizon and the barriers in the view of the world."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Floats, Singles
from drsim.jit import kernel

Picture = NDArray[np.uint8]
Rgb = tuple[float, float, float]


class Surroundings(NamedTuple):
    """What is around the track.

    Attributes:
        panorama: A column for each direction from east over north, the highest row first.
        steepest: Tangent of its greatest height.
        barriers: Inner faces: least x, greatest x, least y, greatest y.
        colors: Of barriers, light boards and haze, 0 to 255.
        haze_m: Depth in which haze makes up 63 %.
    """

    panorama: Picture
    steepest: float
    barriers: tuple[float, float, float, float]
    barrier_m: float
    colors: tuple[Rgb, Rgb, Rgb]
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
    pos: Rgb,
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
    panorama: Picture, steepest: float, ahead: Rgb, step: tuple[float, float], mixed: Singles
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
    pos: Rgb,
    ahead: Rgb,
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
        share, red, green, blue = _barrier(around, pos, (x, y, z), focal_px)
        if share > 0.0:
            mixed[pixel, 0] += share * (red - mixed[pixel, 0])
            mixed[pixel, 1] += share * (green - mixed[pixel, 1])
            mixed[pixel, 2] += share * (blue - mixed[pixel, 2])


@kernel
def _barrier(
    around: Surroundings,
    pos: Rgb,
    ahead: Rgb,
    focal_px: float,
) -> tuple[float, float, float, float]:
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
    if depth >= 1e8:
        return 0.0, 0.0, 0.0, 0.0
    if not (
        low_x - 0.01 <= pos[0] + depth * x <= high_x + 0.01
        and low_y - 0.01 <= pos[1] + depth * y <= high_y + 0.01
    ):
        return 0.0, 0.0, 0.0, 0.0
    pixel_m = depth / focal_px
    height = pos[2] + depth * z
    share = min(max(0.5 + (barrier_m - height) / pixel_m, 0.0), 1.0)
    share *= min(max(0.5 + height / pixel_m, 0.0), 1.0)
    if share == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    # Boards of 1.6 m, every third of them light, with a light edge on top and a dark joint.
    place = along / 1.6
    part = (place - math.floor(place)) * 1.6
    number = math.floor(place) % 3
    mix = 1.0 if number == 0 else 0.0
    edge = min(max(0.5 + (height - 0.84 * barrier_m) / pixel_m, 0.0), 1.0)
    mix = max(mix, edge)
    joint = 1.0 - 0.35 * min(max(1.0 - abs(min(part, 1.6 - part)) / max(0.012, pixel_m), 0.0), 1.0)
    foot = 0.72 + 0.28 * min(max(height / (0.6 * barrier_m), 0.0), 1.0)
    light *= joint * foot
    clear = math.exp(-depth / around.haze_m)
    red = light * (dark[0] + mix * (bright[0] - dark[0]))
    green = light * (dark[1] + mix * (bright[1] - dark[1]))
    blue = light * (dark[2] + mix * (bright[2] - dark[2]))
    return (
        share,
        haze[0] + clear * (red - haze[0]),
        haze[1] + clear * (green - haze[1]),
        haze[2] + clear * (blue - haze[2]),
    )

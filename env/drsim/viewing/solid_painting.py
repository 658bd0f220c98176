"""Draws triangles over a picture: cars and boxes with light and patterns."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import RGB, Bytes, Floats, Ints
from drsim.jit import kernel

_NEAR_M = 0.06


class Triangles(NamedTuple):
    """The triangles of all things in a picture.

    Attributes:
        corners: Column, row, and one over the depth, 0 behind the lens; before, metres. Shape (v,
            3).
        colors: Of things, 0 to 1. Shape (t, 3).
    """

    corners: Floats
    normals: Floats
    places: Floats
    faces: Ints
    materials: Ints
    things: Ints
    colors: Floats


@kernel
def project(
    mesh: tuple[Floats, Floats],
    turns: Floats,
    shifts: Floats,
    owner: Ints,
    lens_parts: tuple[Any, ...],
    size: tuple[int, int],
) -> tuple[Floats, Floats]:
    """Corners and normals, moved into the world; corners on into the picture, as in `Triangles`."""
    corners, normals = mesh
    seen, turned = np.empty_like(corners), np.empty_like(normals)
    pos, forward, left, up, focal_px = lens_parts
    rows, columns = size
    for v in range(len(corners)):
        t, s = turns[owner[v]], shifts[owner[v]]
        a, b, c = corners[v]
        x = t[0, 0] * a + t[0, 1] * b + t[0, 2] * c + s[0] - pos[0]
        y = t[1, 0] * a + t[1, 1] * b + t[1, 2] * c + s[1] - pos[1]
        z = t[2, 0] * a + t[2, 1] * b + t[2, 2] * c + s[2] - pos[2]
        depth = x * forward[0] + y * forward[1] + z * forward[2]
        a, b, c = normals[v]
        turned[v, 0] = t[0, 0] * a + t[0, 1] * b + t[0, 2] * c
        turned[v, 1] = t[1, 0] * a + t[1, 1] * b + t[1, 2] * c
        turned[v, 2] = t[2, 0] * a + t[2, 1] * b + t[2, 2] * c
        if depth < _NEAR_M:
            seen[v, 2] = 0.0
            continue
        scale = focal_px / depth
        seen[v, 0] = 0.5 * columns - scale * (x * left[0] + y * left[1] + z * left[2])
        seen[v, 1] = 0.5 * rows - scale * (x * up[0] + y * up[1] + z * up[2])
        seen[v, 2] = 1.0 / depth
    return seen, turned


@kernel
def draw(
    parts: tuple[Any, ...],
    lens_parts: tuple[Any, ...],
    to_sun: RGB,
    opaque: tuple[int, int],
    opacity: float,
    size: tuple[int, int, int],
    fine: int,
    out: Bytes,
) -> None:
    """Draw triangles over some rows of a picture.

    `opaque`: how many are solid, and how many there are; `size`: rows, columns and first row.
    """
    triangles = Triangles(*parts)
    _, columns, first = size
    window = _window(triangles, opaque[1], first, out.shape[0], columns)
    top, bottom, left, right = window
    if top >= bottom or left >= right:
        return
    high, wide = (bottom - top) * fine, (right - left) * fine
    near = np.zeros((high, wide), np.float32)
    face = np.full((high, wide), -1, np.int32)
    inside = np.empty((high, wide, 2), np.float32)
    for f in range(opaque[0]):
        _find(triangles, f, (first + top, left), fine, near, face, inside)
    _colour(triangles, lens_parts, to_sun, size, window, fine, face, inside, 1.0, out)
    if opaque[0] < opaque[1]:
        face[:] = -1
        for f in range(opaque[0], opaque[1]):
            _find(triangles, f, (first + top, left), fine, near, face, inside)
        _colour(triangles, lens_parts, to_sun, size, window, fine, face, inside, opacity, out)


@kernel
def _window(
    triangles: Triangles, count: int, first: int, high: int, columns: int
) -> tuple[int, int, int, int]:
    corners, faces = triangles.corners, triangles.faces
    top, bottom, left, right = 1e9, -1e9, 1e9, -1e9
    for f in range(count):
        for k in range(3):
            x, y, z = corners[faces[f, k]]
            if z > 0.0:
                top, bottom = min(top, y), max(bottom, y)
                left, right = min(left, x), max(right, x)
    top, bottom = max(top - 1.0 - first, 0.0), min(bottom + 2.0 - first, float(high))
    left, right = max(left - 1.0, 0.0), min(right + 2.0, float(columns))
    if top >= bottom or left >= right:
        return 0, 0, 0, 0
    return int(top), int(bottom), int(left), int(right)


@kernel
def _find(
    triangles: Triangles,
    f: int,
    corner: tuple[int, int],
    fine: int,
    near: NDArray[np.float32],
    face: NDArray[np.int32],
    inside: NDArray[np.float32],
) -> None:
    faces, corners = triangles.faces, triangles.corners
    a, b, c = corners[faces[f, 0]], corners[faces[f, 1]], corners[faces[f, 2]]
    if a[2] <= 0.0 or b[2] <= 0.0 or c[2] <= 0.0:
        return
    ax, ay = (a[0] - corner[1]) * fine - 0.5, (a[1] - corner[0]) * fine - 0.5
    bx, by = (b[0] - corner[1]) * fine - 0.5, (b[1] - corner[0]) * fine - 0.5
    cx, cy = (c[0] - corner[1]) * fine - 0.5, (c[1] - corner[0]) * fine - 0.5
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if abs(area) < 1e-9:
        return
    high, wide = near.shape
    top = int(max(math.ceil(min(ay, by, cy)), 0.0))
    bottom = int(min(math.floor(max(ay, by, cy)) + 1.0, high))
    left = int(max(math.ceil(min(ax, bx, cx)), 0.0))
    right = int(min(math.floor(max(ax, bx, cx)) + 1.0, wide))
    one = 1.0 / area
    # Shares of the second and third corner change evenly from sample to sample.
    share_b_x, share_b_y = (cy - ay) * one, -(cx - ax) * one
    share_c_x, share_c_y = -(by - ay) * one, (bx - ax) * one
    for row in range(top, bottom):
        for column in range(left, right):
            x, y = column - ax, row - ay
            second = x * share_b_x + y * share_b_y
            third = x * share_c_x + y * share_c_y
            if second < 0.0 or third < 0.0 or second + third > 1.0:
                continue
            closeness = a[2] + second * (b[2] - a[2]) + third * (c[2] - a[2])
            if closeness > near[row, column]:
                near[row, column] = closeness
                face[row, column] = f
                inside[row, column, 0] = second * b[2] / closeness
                inside[row, column, 1] = third * c[2] / closeness


@kernel
def _colour(
    triangles: Triangles,
    lens_parts: tuple[Any, ...],
    to_sun: RGB,
    size: tuple[int, int, int],
    window: tuple[int, int, int, int],
    fine: int,
    face: NDArray[np.int32],
    inside: NDArray[np.float32],
    opacity: float,
    out: Bytes,
) -> None:
    _, forward, to_left, to_up, focal_px = lens_parts
    rows, columns, first = size
    top, bottom, begin, end = window
    part = opacity / (fine * fine)
    # Taken out of the record once: each access in the loop would count references.
    faces, materials, things = triangles.faces, triangles.materials, triangles.things
    normals, places, colors = triangles.normals, triangles.places, triangles.colors
    for row in range(bottom - top):
        up = (0.5 * rows - (first + top + row + 0.5)) / focal_px
        for column in range(end - begin):
            total, shade, count, before = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0, -1
            for sample in range(fine * fine):
                y, x = row * fine + sample // fine, column * fine + sample % fine
                f = face[y, x]
                if f < 0:
                    continue
                # Of a triangle without a pattern, one sample shows what all show.
                if f != before or _has_pattern(materials[f]):
                    before = f
                    i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
                    second, third = inside[y, x, 0], inside[y, x, 1]
                    share = 1.0 - second - third
                    normal = (
                        share * normals[i, 0] + second * normals[j, 0] + third * normals[k, 0],
                        share * normals[i, 1] + second * normals[j, 1] + third * normals[k, 1],
                        share * normals[i, 2] + second * normals[j, 2] + third * normals[k, 2],
                    )
                    u = share * places[i, 0] + second * places[j, 0] + third * places[k, 0]
                    v = share * places[i, 1] + second * places[j, 1] + third * places[k, 1]
                    left = (0.5 * columns - (begin + column + 0.5)) / focal_px
                    ray = (
                        forward[0] + left * to_left[0] + up * to_up[0],
                        forward[1] + left * to_left[1] + up * to_up[1],
                        forward[2] + left * to_left[2] + up * to_up[2],
                    )
                    thing = things[f]
                    paint = (colors[thing, 0], colors[thing, 1], colors[thing, 2])
                    shade = _shaded(materials[f], paint, u, v, normal, ray, to_sun)
                total = _sum(total, shade)
                count += 1
            if count:
                rest, bright = 1.0 - part * count, 255.0 * part
                pixel = out[top + row, begin + column]
                for channel in range(3):
                    seen = pixel[channel] * rest + bright * total[channel] + 0.499
                    pixel[channel] = np.uint8(seen)


@kernel
def _has_pattern(material: int) -> bool:
    return material == 1 or material == 4 or material >= 8


@kernel
def _shaded(
    material: int, paint: RGB, u: float, v: float, normal: RGB, ray: RGB, to_sun: RGB
) -> RGB:
    normal = _scaled(normal, 1.0 / math.sqrt(_dot(normal, normal) + 1e-12))
    ray = _scaled(ray, 1.0 / math.sqrt(_dot(ray, ray)))
    facing = _dot(ray, normal)
    if facing > 0.0:  # seen from behind, such as the inside of a rim
        normal, facing = _scaled(normal, -1.0), -facing
    color, gloss = _surface(material, paint, u, v, normal[2])
    if gloss < 0.0:
        return color  # a lamp
    sun = max(_dot(normal, to_sun), 0.0)
    sky = 0.5 + 0.5 * normal[2]
    color = (
        color[0] * (0.36 + 0.26 * sky + 0.58 * sun),
        color[1] * (0.36 + 0.28 * sky + 0.56 * sun),
        color[2] * (0.36 + 0.33 * sky + 0.52 * sun),
    )
    if gloss > 0.0:
        back = _sum(ray, _scaled(normal, -2.0 * facing))
        edge = (1.0 + facing) ** 2
        mirror = gloss * (0.06 + 0.55 * edge * edge)
        mirrored = (0.26, 0.27, 0.24)
        if back[2] > 0.0:
            high = min(back[2] * 1.6, 1.0)
            mirrored = (0.86 - 0.50 * high, 0.91 - 0.36 * high, 0.95 - 0.12 * high)
        away = _sum(mirrored, _scaled(color, -1.0))
        flash = gloss * 0.75 * max(_dot(back, to_sun), 0.0) ** 40
        color = _sum(_sum(color, _scaled(away, mirror)), (flash, flash, 0.92 * flash))
    return min(color[0], 1.0), min(color[1], 1.0), min(color[2], 1.0)


@kernel
def _dot(one: RGB, other: RGB) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@kernel
def _scaled(vector: RGB, factor: float) -> RGB:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


@kernel
def _sum(one: RGB, other: RGB) -> RGB:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]


_SURFACES = (
    ((0.045, 0.055, 0.075), 1.7),
    ((0.075, 0.075, 0.08), 0.12),
    ((0.0, 0.0, 0.0), 0.0),
    ((0.09, 0.09, 0.10), 0.35),
    ((1.0, 0.98, 0.88), -1.0),
    ((0.93, 0.10, 0.08), -1.0),
)
"""Of the materials from glass to tail lamps; a rim has a pattern."""


@kernel
def _surface(material: int, paint: RGB, u: float, v: float, upward: float) -> tuple[RGB, float]:
    """Colour and gloss, which is negative where it shines by itself."""
    if material == 1 and upward > 0.25 and 0.006 < abs(v) < 0.0165:
        light = 0.3 * paint[0] + 0.59 * paint[1] + 0.11 * paint[2]
        return ((0.10, 0.12, 0.16) if light > 0.7 else (0.96, 0.96, 0.95)), 1.0
    if material <= 1:
        return paint, 1.0
    if material == 4:
        return _rim(u, v)
    if material <= 7:
        return _SURFACES[material - 2]
    edge = max(abs(u), abs(v))
    worn = 0.82 if edge > 0.955 else 1.0
    gloss = 0.15
    if material == 8:
        # Cardboard: adhesive tape over the top and down two sides, and pale lines of the fluting.
        tape = (upward > 0.7 and abs(v) < 0.15) or (upward < 0.7 and abs(u) < 0.15 and v > 0.35)
        if tape:
            return (0.80 * worn, 0.70 * worn, 0.52 * worn), 0.25
        worn, gloss = worn * (1.0 + 0.025 * math.sin(60.0 * u)), 0.0
    elif material == 9:
        gloss = 0.3
        if abs(v) < 0.42 and upward < 0.7:
            slant = (u + v) * 2.5
            paint, gloss = (0.93, 0.93, 0.93), 0.2
            if slant - math.floor(slant) < 0.5:
                paint = (0.98, 0.60, 0.08)
    return _scaled(paint, worn), gloss


@kernel
def _rim(u: float, v: float) -> tuple[RGB, float]:
    away = math.hypot(u, v)
    turn = math.atan2(v, u) * 5.0 / (2.0 * math.pi)
    part = abs(turn - math.floor(turn) - 0.5)
    if away < 0.15 or away > 0.60 or part < 0.17:
        return (0.74, 0.75, 0.78), 0.9
    return (0.10, 0.10, 0.11), 0.1

"""Corners of generated circuits: closed polygons that do not cross themselves. Shape (k, 2)."""

import math
from dataclasses import dataclass
from random import Random
from typing import Literal

import numpy as np

from drsim.arrays import Bools, Floats

_NEAR = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
_SIDES = _NEAR[::2]
_MOVED = 0.3


@dataclass(frozen=True)
class Layout:
    """Where a circuit is to have its corners.

    Attributes:
        kind: "short" is a short tour through scattered points, "winding" the most crooked one, and
            "folded" the outline of cells: hairpins, and straights side by side.
        length_m: Of the polygon, about.
        apart_m: Least distance of corners, and width of a cell.
        stretch: Width of the ground or of a cell over its height.
        lean: Of cells: how far they are no rectangles, -1 .. 1.
        pulled: Share of the length that is put into long straights.
        bumps: Share of the long edges that get an S bend or a chicane.
    """

    kind: Literal["short", "winding", "folded"]
    length_m: float
    apart_m: float
    stretch: float
    lean: float
    pulled: float
    bumps: float


def corners_of(layout: Layout, random: Random) -> Floats:
    corners = (_outline if layout.kind == "folded" else _tour)(layout, random)
    corners = _pulled(corners, layout, random)
    return _with_bumps(corners * (layout.length_m / length_of(corners)), layout.bumps, random)


def length_of(ring: Floats) -> float:
    """The first point is not repeated."""
    return float(np.hypot(*(np.roll(ring, -1, axis=0) - ring).T).sum())


def _tour(layout: Layout, random: Random) -> Floats:
    # Between neighbours lies more than `apart_m`: so many times, measured over a hundred tours.
    step_m = layout.apart_m * (1.5 if layout.kind == "winding" else 1.25)
    count = max(5, round((1.0 - layout.pulled) * layout.length_m / step_m))
    height = layout.apart_m * math.sqrt(1.4 * count / layout.stretch)
    points: list[tuple[float, float]] = []
    for _ in range(40 * count):
        x, y = layout.stretch * height * random.random(), height * random.random()
        if all(math.hypot(x - u, y - v) > layout.apart_m for u, v in points):
            points.append((x, y))
            if len(points) == count:
                break
    corners = np.array(points)[np.argsort([random.random() for _ in points])]
    return _uncrossed(corners, keep_winding=layout.kind == "winding")


def _uncrossed(corners: Floats, *, keep_winding: bool) -> Floats:
    """In another order: no exchange of two edges shortens it, or none of two that cross."""
    k = len(corners)
    while True:
        after = np.roll(corners, -1, axis=0)
        step = np.hypot(*(after - corners).T)
        gain = step[:, None] + step - _distances(corners) - _distances(after)
        if keep_winding:
            gain *= _crossings(corners, after)
        first, second = divmod(int(np.argmax(np.triu(gain, 1))), k)
        if gain[first, second] < 1e-6 or second <= first:
            return corners
        corners[first + 1 : second + 1] = corners[first + 1 : second + 1][::-1]


def _distances(points: Floats) -> Floats:
    apart: Floats = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    return apart


def _crossings(starts: Floats, ends: Floats) -> Bools:
    """Whether each edge crosses each other one."""
    along = ends - starts

    def sides(points: Floats) -> Floats:
        x, y = (points - starts[:, None]).transpose(2, 0, 1)
        return np.asarray(along[:, :1] * y - along[:, 1:] * x)

    parted: Bools = sides(starts) * sides(ends) < 0.0
    return parted & parted.T


def _outline(layout: Layout, random: Random) -> Floats:
    """Of a random patch of cells without holes, its corners moved a little."""
    size_m = np.full(2, layout.apart_m)
    size_m[int(2 * random.random())] *= 0.4 + 0.6 * layout.stretch
    cells = _patch(size_m, (1.0 - layout.pulled) * layout.length_m, random)
    onward = {}
    for x, y in sorted(cells):
        ring = ((x + 1, y), (x + 1, y + 1), (x, y + 1), (x, y))
        for k, (u, v) in enumerate(_SIDES):
            if (x + u, y + v) not in cells:
                onward[ring[k]] = ring[(k + 1) % 4]
    loop = [min(onward)]
    while (place := onward[loop[-1]]) != loop[0]:
        loop.append(place)
    places = np.array(loop, dtype=np.float64)
    over_two = np.abs(np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0))
    corners: Floats = places[over_two.min(axis=1) > 0.5]
    moved = np.array([(random.random(), random.random()) for _ in corners]) - 0.5
    corners = (corners + _MOVED * moved) * size_m
    corners[:, 0] += layout.lean * corners[:, 1]
    return corners


def _patch(size_m: Floats, length_m: float, random: Random) -> set[tuple[int, int]]:
    thin = random.random()
    cells, outline_m = {(0, 0)}, 2 * float(size_m.sum())
    border = set(_SIDES)
    while outline_m < length_m and border:
        x, y = sorted(border)[int(len(border) * random.random())]
        border.discard((x, y))
        near = [(x + u, y + v) in cells for u, v in _NEAR]
        sides = sum(near[::2])
        # A cell beside two separate stretches of others would enclose a hole.
        stretches = sum(a and not b for a, b in zip(near, [*near[1:], near[0]], strict=True))
        if stretches != 1 or not sides or (sides > 1 and random.random() < thin):
            continue
        cells.add((x, y))
        outline_m += sum(
            (-1 if near[2 * k] else 1) * float(size_m[1 - k % 2]) for k in range(len(_SIDES))
        )
        border |= {(x + u, y + v) for u, v in _SIDES} - cells
    return cells


def _pulled(corners: Floats, layout: Layout, random: Random) -> Floats:
    """Cut in two, the halves drawn apart: the edges between them become long."""
    axis = int(2 * random.random())
    cut = 0.25 + 0.5 * random.random()
    low, high = corners[:, axis].min(), corners[:, axis].max()
    beyond = corners[:, axis] > low + cut * (high - low)
    share = layout.pulled / (1.0 - layout.pulled)
    corners[beyond, axis] += 0.5 * share * length_of(corners)
    return corners


def _with_bumps(corners: Floats, bumps: float, random: Random) -> Floats:
    found: list[Floats] = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        found.append(start)
        edge_m = float(np.hypot(*(end - start)))
        along = (end - start) / edge_m
        across = np.array([-along[1], along[0]]) * (0.3 + 0.7 * random.random())
        count, step_m = 2 + int(4 * random.random()), 1.0 + 0.8 * random.random()
        begin_m = (edge_m - (count - 1) * step_m) * random.random()
        if min(begin_m, edge_m - begin_m - (count - 1) * step_m) < step_m:
            continue
        if random.random() < bumps:
            found += [
                start + along * (begin_m + k * step_m) + across * (-0.5, 0.5)[k % 2]
                for k in range(count)
            ]
    return np.array(found)

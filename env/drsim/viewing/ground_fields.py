"""Distances on the ground of a track, on a coarse grid, for edges that are sharp in any picture."""

import math
from dataclasses import dataclass

import numpy as np

from drsim.arrays import Floats, Singles
from drsim.jit import kernel
from drsim.track.polyline import without_repeats
from drsim.track.ring_crossings import cross_ring, sign_off_road
from drsim.track.track import Track

CELL_M = 0.02
MOST_CELLS = 3_000_000
"""60 MB."""

REACH_M = 0.6
SIDE, KERB, ALONG_BORDER, CENTRE, ALONG_CENTRE = range(5)
"""Distance to the nearest border, positive on the road; share of a kerb there; distance along the
border; distance to and along the centre line. Metres.
"""

KERB_RADIUS_M = (1.6, 3.0)
"""Of bends with a whole kerb, and without."""

_BEND_M = 0.5
"""Border that a bend is measured on, to both sides."""


@dataclass(frozen=True, eq=False)
class GroundFields:
    """Cells of shape (rows, columns, 5)."""

    cells: Singles
    x_m: float
    y_m: float
    cell_m: float


def measure_ground(track: Track, *, everywhere: bool) -> GroundFields:
    """0.1 to 0.4 s; with kerbs at bends or `everywhere`."""
    center = without_repeats(track.center[::-1] if track.reverse else track.center)
    inner, outer = (
        without_repeats(line[::-1] if track.reverse else line)
        for line in (track.inner, track.outer)
    )
    border = np.concatenate([inner, outer])
    low, high = border.min(axis=0) - REACH_M, border.max(axis=0) + REACH_M
    cell_m = max(CELL_M, math.sqrt(float((high - low).prod()) / MOST_CELLS))
    columns, rows = (np.ceil((high - low) / cell_m).astype(int) + 1).tolist()

    crossed = np.zeros((rows, columns), np.bool_)
    if track.closed:
        cross_ring(_in_cells(inner, low, cell_m), crossed)
        cross_ring(_in_cells(outer, low, cell_m), crossed)
    else:
        cross_ring(_in_cells(np.concatenate([outer, inner[::-1]]), low, cell_m), crossed)
    cells = np.zeros((rows, columns, 5), np.float32)
    cells[:, :, SIDE] = cells[:, :, CENTRE] = REACH_M
    for line in (inner, outer):
        kerbs = np.ones(len(line)) if everywhere else kerbs_of(line, track.closed)
        _stamp(line - low, kerbs, track.closed, cell_m, SIDE, cells)
    _stamp(center - low, np.zeros(len(center)), track.closed, cell_m, CENTRE, cells)
    sign_off_road(crossed, cells[:, :, SIDE])
    return GroundFields(cells, float(low[0]), float(low[1]), cell_m)


def kerbs_of(line: Floats, closed: bool) -> Floats:
    steps = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    length = float(along[-1])

    def at(distance_m: Floats) -> Floats:
        where = distance_m % length if closed else np.clip(distance_m, 0.0, length)
        return np.stack([np.interp(where, along, line[:, k]) for k in range(2)], axis=1)

    here = at(along)
    ahead, behind = at(along + _BEND_M) - here, here - at(along - _BEND_M)
    turn = np.arctan2(
        behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0], (behind * ahead).sum(axis=1)
    )
    least, most = KERB_RADIUS_M
    bend = np.abs(turn) / _BEND_M
    kerbs: Floats = np.clip((bend - 1.0 / most) / (1.0 / least - 1.0 / most), 0.0, 1.0)
    return kerbs


def _in_cells(points: Floats, low: Floats, cell_m: float) -> Floats:
    return np.ascontiguousarray((points - low) / cell_m)


@kernel
def _stamp(
    line: Floats, kerbs: Floats, closed: bool, cell_m: float, first: int, cells: Singles
) -> None:
    rows, columns, _ = cells.shape
    last = len(line) - 1
    passed = 0.0
    for i in range(1, len(line)):
        ax, ay = line[i - 1]
        dx, dy = line[i, 0] - ax, line[i, 1] - ay
        square = max(dx * dx + dy * dy, 1e-12)
        step = math.sqrt(square)
        top = max(math.ceil((min(ay, ay + dy) - 0.6) / cell_m), 0)
        bottom = min(math.floor((max(ay, ay + dy) + 0.6) / cell_m) + 1, rows)
        left = max(math.ceil((min(ax, ax + dx) - 0.6) / cell_m), 0)
        right = min(math.floor((max(ax, ax + dx) + 0.6) / cell_m) + 1, columns)
        for row in range(top, bottom):
            for column in range(left, right):
                px, py = column * cell_m - ax, row * cell_m - ay
                along = (px * dx + py * dy) / square
                if not closed and ((i == 1 and along < 0.0) or (i == last and along > 1.0)):
                    continue
                along = min(max(along, 0.0), 1.0)
                away = math.hypot(px - along * dx, py - along * dy)
                if away < cells[row, column, first]:
                    cells[row, column, first] = away
                    if first == 0:
                        cells[row, column, 1] = kerbs[i - 1] + along * (kerbs[i] - kerbs[i - 1])
                        cells[row, column, 2] = passed + along * step
                    else:
                        cells[row, column, 4] = passed + along * step
        passed += step

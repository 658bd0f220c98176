"""A line by its offset from the centre line at stations along the lap."""

from typing import NamedTuple

import numpy as np

from drsim.arrays import Floats
from drsim.limit.fastest_line import Line
from drsim.track.track import Track

STATION_M = 0.2
_FARTHEST_M = 2.0


class Stations(NamedTuple):
    """A line at evenly spaced places of the centre line, from waypoint 0. Shape (n,).

    `offset_m` is to the left, along the section between the borders.
    """

    offset_m: Floats
    speed_mps: Floats
    clock_s: Floats


def stations_of(track: Track, line: Line) -> Stations:
    count = max(24, round(track.length_m / STATION_M))
    centers, across = _sections(track, count)
    apart = line.xy[None] - centers[:, None]
    before = across[:, None, 0] * apart[..., 1] - across[:, None, 1] * apart[..., 0]
    along = (apart * across[:, None]).sum(axis=2)
    after, along_after = np.roll(before, -1, axis=1), np.roll(along, -1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = before / (before - after)
    offset = along + share * (along_after - along)
    crossed = (before * after <= 0.0) & (before != after) & (np.abs(offset) < _FARTHEST_M)
    # Of several crossings, the one where the line is as far on its lap as the section.
    lap = np.arange(len(line.xy)) / len(line.xy)
    apart_on_lap = np.abs((lap - np.arange(count)[:, None] / count + 0.5) % 1.0 - 0.5)
    node = np.where(crossed, apart_on_lap, np.inf).argmin(axis=1)
    row = np.arange(count)
    part = np.where(crossed[row, node], share[row, node], 0.0)
    clock = np.concatenate([[0.0], np.cumsum(line.step_s)])
    later = (node + 1) % len(line.xy)
    speed = line.speed_mps[node] * (1.0 - part) + line.speed_mps[later] * part
    clock_s = clock[node] * (1.0 - part) + clock[node + 1] * part
    clock_s = (clock_s - clock_s[0]) % line.lap_s
    place = np.where(crossed[row, node], offset[row, node], along[row, node])
    return Stations(place, speed, np.maximum.accumulate(clock_s))


def points_of(track: Track, offset_m: Floats) -> Floats:
    centers, across = _sections(track, len(offset_m))
    return centers + offset_m[:, None] * across


def _sections(track: Track, count: int) -> tuple[Floats, Floats]:
    steps = np.hypot(*np.diff(track.center, axis=0).T)
    along_m = np.concatenate([[0.0], np.cumsum(steps)])
    kept = np.concatenate([[True], steps > 0.0])
    at_m = np.arange(count) * along_m[-1] / count

    def at(rows: Floats) -> Floats:
        columns = [np.interp(at_m, along_m[kept], rows[kept, axis]) for axis in (0, 1)]
        return np.column_stack(columns)

    left, right = (track.inner, track.outer) if track.is_ccw else (track.outer, track.inner)
    across = at(left) - at(right)
    return at(track.center), across / np.hypot(*across.T)[:, None]

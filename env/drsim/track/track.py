"""Geometry of a track: where points lie along it, whether they are on it, poses on lanes."""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from drsim.arrays import Bools, Floats
from drsim.track import polyline
from drsim.track.polyline import END_M, END_X, START_M, START_X, YAW_RAD, Location

Lane = Literal["center", "inner", "outer"]

LANES: tuple[Lane, Lane, Lane] = ("center", "inner", "outer")
CENTER, INNER, OUTER = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Track:
    """A road between two borders, in driving order; `load_track` makes checked ones.

    Attributes:
        center: Metres, a row for each waypoint. On a closed track the last row repeats the first.
            Any row may repeat the one before, as in 59 routes of the reference simulator. Shape
            (n, 2).
        inner: Border inside the loop, row by row beside `center`. Shape (n, 2).
        outer: Border outside the loop. Shape (n, 2).
        closed: Whether it is a loop.
        reverse: Driven against its definition.
        turned: The same road the other way round, for what must be equal to the last bit.
        joined_m: Gap between the ends of a file that was closed to make a loop.
    """

    name: str
    center: Floats
    inner: Floats
    outer: Floats
    closed: bool
    reverse: bool = False
    turned: "Track | None" = field(default=None, repr=False)
    joined_m: float = 0.0

    def __post_init__(self) -> None:
        """All cars share the arrays, so make them read-only."""
        for line in (self.center, self.inner, self.outer):
            line.flags.writeable = False

    def __deepcopy__(self, _: dict[int, Any]) -> "Track":
        return self

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()

    @cached_property
    def length_m(self) -> float:
        return float(self._as_given._center_segments[END_M, -1])

    @cached_property
    def is_ccw(self) -> bool:
        """Whether it is driven counter-clockwise; an open track, as defined."""
        if not self.closed:
            return not self.reverse
        if self.turned is not None:
            return not self.turned.is_ccw
        x, y = (self.center - self.center[0]).T
        return bool(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0)

    @cached_property
    def waypoints(self) -> list[tuple[float, float]]:
        """The closing one included. Do not alter."""
        return [(x, y) for x, y in self.center.tolist()]

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x, least y, greatest x, greatest y in metres."""
        borders = np.concatenate([self.inner, self.outer])
        x_min, y_min = borders.min(axis=0).tolist()
        x_max, y_max = borders.max(axis=0).tolist()
        return x_min, y_min, x_max, y_max

    def reversed(self) -> "Track":
        """The same road, driven the other way."""
        if self.turned is not None:
            return replace(self.turned, name=self.name, reverse=not self.reverse)
        return Track(
            name=self.name,
            center=np.ascontiguousarray(self.center[::-1]),
            inner=np.ascontiguousarray(self.inner[::-1]),
            outer=np.ascontiguousarray(self.outer[::-1]),
            closed=self.closed,
            reverse=not self.reverse,
            turned=self,
        )

    def locate(self, xy: Floats) -> Location:
        """Where points, shape (m, 2), lie along and across the track."""
        points = np.ascontiguousarray(xy, dtype=np.float64)
        return Location(*polyline.locate(points, self._road))

    def on_road(self, xy: Floats) -> Bools:
        """Whether points, shape (..., 2), lie strictly between the borders."""
        points = np.ascontiguousarray(xy, dtype=np.float64).reshape(-1, 2)
        return polyline.inside_road(points, *self._as_given._rings).reshape(xy.shape[:-1])

    def pose_at(self, distance_m: Floats, lane: Lane = "center") -> Floats:
        """Poses on a lane, each towards its next vertex: metres and radians. Shape (m, 3).

        Distances along the centre line wrap on a closed track. The inner and the outer lane are
        midway to a border; a pose is at their nearest point.
        """
        part = np.asarray(distance_m, dtype=np.float64) / self.length_m
        part = part % 1.0 if self.closed else np.clip(part, 0.0, 1.0)
        poses = _poses_on(self._center_segments, part * self.length_m)
        if lane == "center":
            return poses
        line = self._lanes[lane]
        return _poses_on(line, polyline.project(np.ascontiguousarray(poses[:, :2]), line))

    @property
    def _as_given(self) -> "Track":
        return self if self.turned is None else self.turned

    @cached_property
    def _road(self) -> tuple[Any, ...]:
        given = self._as_given
        first, last = polyline.vertices(given.center)
        road = polyline.Road(
            center=given._center_segments,
            inner=polyline.segments(given.inner),
            outer=polyline.segments(given.outer),
            first=first,
            last=last,
            closed=self.closed,
            is_ccw=self.is_ccw,
            backward=self.turned is not None,
        )
        return tuple(road)

    @cached_property
    def _center_segments(self) -> Floats:
        return polyline.segments(self.center)

    @cached_property
    def _lanes(self) -> dict[Lane, Floats]:
        return {
            "inner": polyline.segments((self.center + self.inner) / 2),
            "outer": polyline.segments((self.center + self.outer) / 2),
        }

    @cached_property
    def _rings(self) -> tuple[Floats, Floats]:
        if self.closed:
            return self.outer.copy(), self.inner.copy()  # writable ones: else compiled once more
        return np.concatenate([self.outer, self.inner[::-1], self.outer[:1]]), np.empty((0, 2))


def _poses_on(line: Floats, along_m: Floats) -> Floats:
    k = np.minimum(np.searchsorted(line[END_M], along_m, side="right"), line.shape[1] - 1)
    start, end = line[START_X : START_X + 2, k], line[END_X : END_X + 2, k]
    share = (along_m - line[START_M, k]) / (line[END_M, k] - line[START_M, k])
    return np.stack([*(start + share * (end - start)), line[YAW_RAD, k]], axis=1)

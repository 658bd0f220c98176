"""Computes the fastest line of a car round a closed track, and its speeds.

A nonlinear programme places a point mass on normals of a reference line: the smoothed centre line,
then the line found before.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from drsim.arrays import Floats
from drsim.track.track import Track

# What limits a lap: each car's grip and speed, as measured in the MuJoCo car.
#
# With random requests (99 % of windows of 0.2 s are below), raised to the fastest driving: see
# docs/track-limit.md.


SPEEDS_MPS = (0.0, 0.5, 0.85, 1.1, 1.4, 1.6, 1.9, 2.1, 2.4, 2.6, 2.9, 3.1, 3.4, 3.65, 4.5)
"""Of `Grip.lateral_mps2`."""


@dataclass(frozen=True)
class Grip:
    """What a car can do at most.

    Attributes:
        lateral_mps2: At each of `SPEEDS_MPS`. All wheels turn at one speed, so a slow car
            understeers.
        best_brake_mps2: At which the car corners best.
        pull_per_s: Acceleration for each m/s below the top speed.
        jerk_mps3: Of lateral acceleration: steering lag and inertia.
    """

    lateral_mps2: tuple[float, ...]
    accelerate_mps2: float
    brake_mps2: float
    best_brake_mps2: float
    pull_per_s: float
    jerk_mps3: float
    top_mps: float


GRIPS: Mapping[str, Grip] = MappingProxyType(
    {
        "release-6": Grip(
            (0.0, 1.0, 2.2, 3.4, 4.7, 5.5, 6.1, 6.5, 7.2, 7.75, 8.15, 8.3, 8.1, 7.6, 7.6),
            accelerate_mps2=12.0,
            brake_mps2=12.0,
            best_brake_mps2=1.5,
            pull_per_s=9.5,
            jerk_mps3=75.0,
            top_mps=3.66,
        ),
        "low-grip": Grip(
            (0.0, 1.1, 2.4, 3.5, 4.2, 4.6, 4.9, 5.1, 5.4, 5.5, 5.6, 5.65, 5.65, 5.6, 5.6),
            accelerate_mps2=10.0,
            brake_mps2=10.0,
            best_brake_mps2=1.0,
            pull_per_s=7.5,
            jerk_mps3=50.0,
            top_mps=3.69,
        ),
        "2022": Grip(
            (0.0, 1.0, 3.0, 4.2, 4.6, 4.9, 5.1, 5.4, 5.7, 6.0, 6.0, 5.9, 5.7, 5.1, 5.1),
            accelerate_mps2=8.0,
            brake_mps2=7.0,
            best_brake_mps2=1.0,
            pull_per_s=4.0,
            jerk_mps3=30.0,
            top_mps=3.7,
        ),
    }
)
"""By names in `drsim.car.car_parameters`."""


STEP_M = 0.15
"""With 0.1 m, lap times are 0.2 % longer."""

BEYOND_M = 0.085
"""Of the car's origin beyond a border: half its track width, so that the wheels of one side stay
on.
"""

_SMOOTH_M = 0.3
_REACH_M = 1.6
_GRID_M = 0.01
_ROUNDS = 3
_SLOWEST_MPS = 0.3
_NEARLY = 0.998
_LEAST_ADVANCE = 0.2


class SolverMissing(Exception):
    """The package casadi is not installed."""


class NoLine(Exception):
    """The solver found no line."""


class Line(NamedTuple):
    """A closed line; `xy` in driving order, the first not repeated, shape (n, 2)."""

    xy: Floats
    speed_mps: Floats

    @property
    def step_m(self) -> Floats:
        return np.asarray(np.hypot(*(np.roll(self.xy, -1, axis=0) - self.xy).T))

    @property
    def step_s(self) -> Floats:
        return 2.0 * self.step_m / (self.speed_mps + np.roll(self.speed_mps, -1))

    @property
    def lap_s(self) -> float:
        return float(self.step_s.sum())


def fastest_line(track: Track, grip: Grip) -> Line:
    """In the track's direction, from near waypoint 0.

    Raises:
        SolverMissing: casadi is not installed.
        NoLine: The track is open, or no line was found.
    """
    if not track.closed:
        raise NoLine(f"{track.name} is not a loop, so it has no flying lap")
    middle = _smoothed(_resampled(track.center[:-1]), round(_SMOOTH_M / STEP_M), passes=2)
    line = _improved(track, middle, grip)
    # There are several lines that no small change improves. From the other side, the solver comes
    # to another one now and then, by up to 4 %.
    turned = _improved(track.reversed(), middle[::-1], grip)
    if turned is not None and (line is None or turned.lap_s < _NEARLY * line.lap_s):
        again = _improved(track, _resampled(turned.xy[::-1]), grip)
        if again is not None and (line is None or again.lap_s < line.lap_s):
            line = again
    if line is None:
        raise NoLine(f"the solver found no line on {track.name}")
    first = int(np.hypot(*(line.xy - track.center[0]).T).argmin())
    return Line(np.roll(line.xy, -first, axis=0), np.roll(line.speed_mps, -first))


def _improved(track: Track, reference: Floats, grip: Grip) -> Line | None:
    line = None
    for beyond_m in (0.0, *[BEYOND_M] * (_ROUNDS - 1)):
        normals, low_m, high_m = _room(track, reference, beyond_m)
        found, solved = _solve(reference, normals, low_m, high_m, grip)
        if solved and beyond_m and (line is None or found.lap_s < line.lap_s):
            line = found
        reference = _resampled(found.xy)
        if not solved:
            reference = _smoothed(reference, 1, passes=2)
    return line


def _resampled(xy: Floats) -> Floats:
    closed = np.vstack([xy, xy[:1]])
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    count = max(24, round(along_m[-1] / STEP_M))
    at_m = np.arange(count) * along_m[-1] / count
    return np.column_stack([np.interp(at_m, along_m, closed[:, axis]) for axis in (0, 1)])


def _smoothed(xy: Floats, reach: int, passes: int) -> Floats:
    for _ in range(passes):
        xy = np.mean([np.roll(xy, k, axis=0) for k in range(-reach, reach + 1)], axis=0)
    return xy


def _room(track: Track, line: Floats, beyond_m: float) -> tuple[Floats, Floats, Floats]:
    """Left normals of a line, and how far a car may be along each."""
    ahead = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    normals = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.hypot(*ahead.T)[:, None]
    places_m = np.arange(-_REACH_M, _REACH_M + _GRID_M / 2, _GRID_M)
    on_road = track.on_road(line[:, None] + places_m[:, None] * normals[:, None])
    low_m, high_m = np.empty(len(line)), np.empty(len(line))
    for node, row in enumerate(on_road):
        inside, outside = np.flatnonzero(row), np.flatnonzero(~row)
        if not len(inside):
            raise NoLine(f"{track.name} has no road beside the line at node {node}")
        nearest = inside[np.abs(places_m[inside]).argmin()]
        low_m[node] = places_m[max(outside[outside < nearest], default=-1) + 1]
        high_m[node] = places_m[min(outside[outside > nearest], default=len(row)) - 1]
    return normals, low_m - beyond_m, high_m + beyond_m


def _solve(
    reference: Floats, normals: Floats, low_m: Floats, high_m: Floats, grip: Grip
) -> tuple[Line, bool]:
    try:
        import casadi
    except ImportError as error:
        raise SolverMissing(str(error)) from error
    ca: Any = casadi
    count = len(reference)
    offset, speed = ca.MX.sym("offset", count), ca.MX.sym("speed", count)

    def after(values: Any) -> Any:
        return ca.vertcat(values[1:], values[0])

    def before(values: Any) -> Any:
        return ca.vertcat(values[-1], values[:-1])

    x = reference[:, 0] + offset * normals[:, 0]
    y = reference[:, 1] + offset * normals[:, 1]
    dx, dy = after(x) - x, after(y) - y
    step = ca.sqrt(dx**2 + dy**2 + 1e-8)
    dx0, dy0, step0 = before(dx), before(dy), before(step)
    chord = ca.sqrt((dx + dx0) ** 2 + (dy + dy0) ** 2 + 1e-8)
    curvature = 2 * (dx0 * dy - dy0 * dx) / (step * step0 * chord)
    lateral = curvature * speed**2
    # All changes are from a node to the next: differences over two steps would let a line zigzag.
    forward = (after(speed) ** 2 - speed**2) / (2 * step)
    jerk = (after(lateral) - lateral) * (speed + after(speed)) / (2 * step)
    table = ca.interpolant("grip", "bspline", [SPEEDS_MPS], grip.lateral_mps2)
    share = (lateral / table(speed.T).T) ** 2
    above = forward + grip.best_brake_mps2
    used = ca.if_else(
        above > 0,
        above / (grip.accelerate_mps2 + grip.best_brake_mps2),
        above / (grip.brake_mps2 - grip.best_brake_mps2),
    )
    steps = np.roll(reference, -1, axis=0) - reference
    advance = (dx * steps[:, 0] + dy * steps[:, 1]) / (steps**2).sum(axis=1)
    limits: list[tuple[Any, float, float]] = [
        (share + used**2, -np.inf, 1.0),
        (after(share) + used**2, -np.inf, 1.0),
        (forward + grip.pull_per_s * ((speed + after(speed)) / 2 - grip.top_mps), -np.inf, 0.0),
        (jerk / grip.jerk_mps3, -1.0, 1.0),
        (advance, _LEAST_ADVANCE, np.inf),
    ]
    solver = ca.nlpsol(
        "fastest",
        "ipopt",
        {
            "x": ca.vertcat(offset, speed),
            "f": ca.sum1(2 * step / (speed + after(speed))),
            "g": ca.vertcat(*[expression for expression, _, _ in limits]),
        },
        {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-4},
    )
    low_m = np.minimum(low_m, high_m - _GRID_M)
    found = solver(
        x0=np.concatenate([np.clip(0.0, low_m, high_m), np.ones(count)]),
        lbx=np.concatenate([low_m, np.full(count, _SLOWEST_MPS)]),
        ubx=np.concatenate([high_m, np.full(count, grip.top_mps)]),
        lbg=np.repeat([least for _, least, _ in limits], count),
        ubg=np.repeat([most for _, _, most in limits], count),
    )
    values = np.array(found["x"]).ravel()
    line = Line(reference + values[:count, None] * normals, values[count:])
    return line, bool(solver.stats()["success"])


# A line by its offset from the centre line at stations along the lap.


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

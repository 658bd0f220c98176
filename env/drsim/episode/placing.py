"""Where on the lap cars are put, and how they keep their own stretch."""

import math
from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from drsim.arrays import Bools, Floats, Ints, Seeds
from drsim.car.car import WHEELS_M, CarBatch
from drsim.episode.episode_rules import EpisodeState, Status
from drsim.jit import kernel
from drsim.race.traffic import Contacts, Traffic
from drsim.track.polyline import Location
from drsim.track.track import CENTER, INNER, LANES, OUTER, Lane, Track
from drsim.track.ways import Ways

Side = Literal["left", "centre", "right"]

STEP_M = 0.01


class StartPose(NamedTuple):
    """Pose in metres and radians, and the real offset to the left."""

    pose: Floats
    offset_m: float
    on_road: bool


def offset_of(track: Track, fraction: float, side: Side) -> float:
    """Midway between centre line and border of this side, left positive."""
    if side == "centre":
        return 0.0
    distance_m = np.array([fraction * track.length_m])
    centre = track.pose_at(distance_m)[0]
    lane = track.pose_at(distance_m, "inner" if (side == "left") == track.is_ccw else "outer")[0]
    return float((lane[:2] - centre[:2]) @ _leftwards(centre[2]))


def start_pose(track: Track, fraction: float, offset_m: float, angle_deg: float) -> StartPose:
    """The start that was asked for, or the nearest one towards the centre line on the road.

    Offset and angle are to the left.
    """
    centre = track.pose_at(np.array([fraction * track.length_m]))[0]
    yaw = centre[2] + np.radians(angle_deg)
    found = StartPose(np.array([*centre[:2], yaw]), 0.0, False)
    # Outwards, because a neighbouring stretch of the road may lie further out.
    steps = math.ceil(abs(offset_m) / STEP_M)
    for tried_m in (*(math.copysign(STEP_M * step, offset_m) for step in range(steps)), offset_m):
        pose = np.array([*(centre[:2] + tried_m * _leftwards(centre[2])), yaw])
        if not _all_wheels_on(track, pose):
            break
        found = StartPose(pose, tried_m, True)
    return found


def _leftwards(yaw_rad: float) -> Floats:
    return np.array([-np.sin(yaw_rad), np.cos(yaw_rad)])


def _all_wheels_on(track: Track, pose: Floats) -> bool:
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin], [sin, cos]])
    return bool(track.on_road(pose[:2] + WHEELS_M[:, :2] @ turn.T).all())


_PARKED_BESIDE_M = 0.3
JUMP_M = 1.0
"""No car drives this far in one step."""

_SAMPLES = 81


class Placing:
    """Poses on the lanes of the tracks."""

    def __init__(self, ways: Ways) -> None:
        self.ways = ways

    def on(self, cars: Ints, fraction: Floats, lane: Lane = "center") -> Floats:
        """Poses on one lane in driving direction: metres and radians. Shape (k, 3).

        `fraction` is of the lap in the car's own direction.
        """
        ways = self.ways.way[cars]
        poses = np.empty((len(cars), 3))
        for k in np.unique(ways):
            chosen, track = ways == k, self.ways.tracks[k]
            poses[chosen] = track.pose_at(fraction[chosen] * track.length_m, lane)
        return poses

    def on_each(self, cars: Ints, fraction: Floats, lanes: Ints) -> Floats:
        poses = np.empty((len(cars), 3))
        for lane, name in enumerate(LANES):
            chosen = lanes == lane
            if chosen.any():
                poses[chosen] = self.on(cars[chosen], fraction[chosen], name)
        return poses

    def nearer_lane(self, cars: Ints, fraction: Floats, xy: Floats) -> Ints:
        """Inner or outer lane, by index."""
        to_inner_m, to_outer_m = (
            np.hypot(*(self.on(cars, fraction, lane)[:, :2] - xy).T) for lane in LANES[1:]
        )
        return np.where(to_inner_m <= to_outer_m, INNER, OUTER)

    def aside(self, cars: Ints, fraction: Floats) -> Floats:
        poses = self.on(cars, fraction)
        for car, pose in zip(cars, poses, strict=True):
            x_min, y_min, x_max, y_max = self.ways.of(car).bounds
            low, high = np.array([x_min, y_min]), np.array([x_max, y_max])
            outwards_m = np.stack([pose[:2] - low, high - pose[:2]])
            side, axis = np.unravel_index(outwards_m.argmin(), outwards_m.shape)
            pose[axis] = (low - _PARKED_BESIDE_M, high + _PARKED_BESIDE_M)[side][axis]
        return poses


def fraction_at(progress: Floats, start_fraction: Floats) -> Floats:
    return (start_fraction + progress / 100.0) % 1.0


def without_jump(track: Track, xy: Floats, found_m: float, before_m: float) -> float:
    """Distance along the centre line, unless it belongs to a neighbouring stretch of the track.

    After such a jump in one step, the nearest place within `JUMP_M`, to 2.5 cm.
    """
    gap_m = found_m - before_m
    if track.closed:
        gap_m = (gap_m + track.length_m / 2) % track.length_m - track.length_m / 2
    if abs(gap_m) <= JUMP_M:
        return found_m
    nearby_m = before_m + np.linspace(-JUMP_M, JUMP_M, _SAMPLES)
    away_m = np.hypot(*(track.pose_at(nearby_m)[:, :2] - xy).T)
    nearest_m = float(nearby_m[np.argmin(away_m)])
    if track.closed:
        return nearest_m % track.length_m
    return min(max(nearest_m, 0.0), track.length_m)


# Puts cars on the track: where episodes begin and go on, and aside.


class CarPlacement:
    """Places the cars of a simulation, some at a time."""

    def __init__(self, placing: Placing, cars: CarBatch, traffic: Traffic | None) -> None:
        self._placing = placing
        self._cars = cars
        self._traffic = traffic

    def start(
        self,
        cars: Ints,
        fraction: Floats,
        seeds: Seeds,
        offset_m: Floats | None,
        angle_deg: Floats | None,
    ) -> None:
        if self._traffic is None:
            self._cars.place(cars, self._placing.on(cars, fraction))
        else:
            self._traffic.begin(cars, fraction, seeds)
            gap = self._traffic.start_gap_m(cars) / self._placing.ways.length_m[cars]
            lanes = self._traffic.start_lane(cars)
            self._cars.place(cars, self._placing.on_each(cars, fraction - gap, lanes))
            self._follow()
        if offset_m is not None or angle_deg is not None:
            self._turn_aside(cars, fraction, offset_m, angle_deg)

    def put_back(
        self,
        cars: Ints,
        state: EpisodeState,
        status: Ints,
        came_from: Floats,
        contacts: Contacts | None,
    ) -> None:
        """Place cars whose violation is forgiven.

        After a crash into another car, where it is; else where it came from, on the nearer lane,
        clear of obstacles.
        """
        stays = np.zeros(len(cars), np.bool_)
        progress = state.previous_progress[cars]
        if contacts is not None:
            into = status[cars] == Status.CRASHED
            stays = into & ~contacts.other_stands[cars]
            progress = np.where(into, state.progress[cars], progress)
        fraction = fraction_at(progress, state.start_fraction[cars])
        lanes = self._placing.nearer_lane(cars, fraction, came_from[cars])
        if self._traffic is not None:
            moved: Bools = ~stays
            fraction[moved], lanes[moved] = self._traffic.clear_of(
                cars[moved], fraction[moved], lanes[moved]
            )
        poses = self._placing.on_each(cars, fraction, lanes)
        self._cars.place(cars, np.where(stays[:, None], self._poses(cars), poses))
        self._follow()

    def move_aside(self, cars: Ints, fraction: Floats) -> None:
        self._cars.place(cars, self._placing.aside(cars, fraction))

    def _turn_aside(
        self, cars: Ints, fraction: Floats, offset_m: Floats | None, angle_deg: Floats | None
    ) -> None:
        nothing = np.zeros(len(cars))
        offset_m = nothing if offset_m is None else np.asarray(offset_m, np.float64)
        angle_deg = nothing if angle_deg is None else np.asarray(angle_deg, np.float64)
        on_line = np.ones(len(cars), np.bool_)
        if self._traffic is not None:
            on_line = self._traffic.start_lane(cars) == CENTER
        # Only these: reading a pose and placing the car there again may change its last bit.
        moved = np.flatnonzero((offset_m != 0.0) | (angle_deg != 0.0))
        poses = self._poses(cars[moved])
        for row, k in enumerate(moved):
            if on_line[k]:
                track = self._placing.ways.of(cars[k])
                poses[row] = start_pose(track, fraction[k], offset_m[k], angle_deg[k]).pose
            else:
                poses[row, 2] += np.radians(angle_deg[k])
        self._cars.place(cars[moved], poses)
        self._follow()

    def _poses(self, cars: Ints) -> Floats:
        return np.column_stack([self._cars.origin_xy[cars], self._cars.yaw_rad[cars]])

    def _follow(self) -> None:
        if self._traffic is not None:
            self._traffic.follow(self._cars.origin_xy, self._cars.yaw_rad)


# Finds cars whose physics failed, by how they moved.


FURTHEST_M = 1.0
"""In a step; the fastest car makes 0.27 m. With infinite numbers, the physics engine puts a car to
the origin.
"""

HIGHEST_M = 0.5
"""A camera is fixed 0.13 m above the ground."""


@kernel
def mark_unstable(
    xy: Floats, came_from: Floats, yaw_rad: Floats, lens_pos: Floats, unstable: Bools
) -> bool:
    """Mark cars that moved in a way that no car can, in place; whether there are any."""
    any_unstable = False
    for i in range(len(unstable)):
        moved_m = max(abs(xy[i, 0] - came_from[i, 0]), abs(xy[i, 1] - came_from[i, 1]))
        # Written so that NaN is unstable, too.
        stable = moved_m < FURTHEST_M and abs(lens_pos[i, 2]) < HIGHEST_M
        unstable[i] = not (stable and math.isfinite(xy[i, 0] + xy[i, 1] + yaw_rad[i]))
        any_unstable = any_unstable or unstable[i]
    return any_unstable


class TrackPositions:
    """Places of all cars, each on the track in its own driving direction.

    Attributes:
        where: Rows that were handed out stay as they are.
        along_m: Without jumps to neighbouring stretches. Shape (n,).
    """

    where: Location
    wheels_on: Ints

    def __init__(self, ways: Ways, cars: CarBatch) -> None:
        self._ways = ways
        self._cars = cars
        self._all: Ints = np.arange(len(ways.way))
        self.along_m: Floats = np.zeros(len(ways.way))
        self._look()

    def refresh(self) -> None:
        """Find all cars; one that stands still stays at its place."""
        stands = (self._cars.front_xy == self._seen_xy).all(axis=1)
        self._look()
        along_m = self.where.distance_m.copy()
        along_m[stands] = self.along_m[stands]
        for car in np.flatnonzero(np.abs(along_m - self.along_m) > JUMP_M).tolist():
            along_m[car] = without_jump(
                self._ways.of(car), self._cars.front_xy[car], along_m[car], self.along_m[car]
            )
        self.along_m = along_m

    def refresh_placed(self, cars: Ints) -> None:
        self._seen_xy[cars] = self._cars.front_xy[cars]
        self.where = Location._make(column.copy() for column in self.where)
        self.wheels_on = self.wheels_on.copy()
        self.wheels_on[cars] = self._ways.on_road(cars, self._cars.wheel_xy[cars])
        self._scatter(self._ways.groups(cars))
        self.along_m[cars] = self.where.distance_m[cars]

    def _look(self) -> None:
        self._seen_xy = self._cars.front_xy.copy()
        (_, track), *others = self._ways.groups(self._all)
        self.where = track.locate(self._cars.front_xy)
        self.wheels_on = self._ways.on_road(self._all, self._cars.wheel_xy)
        self._scatter(others)

    def _scatter(self, groups: Iterable[tuple[Ints, Track]]) -> None:
        for cars, track in groups:
            where = track.locate(self._cars.front_xy[cars])
            for known, column in zip(self.where, where, strict=True):
                known[cars] = column

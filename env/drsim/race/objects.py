"""What a reward function is told about the objects around each car."""

import math
from typing import NamedTuple

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.car.car import FRONT, REFERENCE_POINT_AHEAD_M
from drsim.jit import kernel
from drsim.race.solids import SHAPES
from drsim.track.track import Track

_NEAR_M = 0.2
"""Least visible depth. Source: the reference simulator."""

_WIDE = math.tan(FRONT.field_of_view_rad / 2)
_CAMERA = (
    FRONT.mount_m[0] - REFERENCE_POINT_AHEAD_M,
    FRONT.mount_m[2],
    math.cos(FRONT.pitch_rad),
    math.sin(FRONT.pitch_rad),
    _WIDE,
    _WIDE * FRONT.rows / FRONT.columns,
)
"""How far ahead of the car's reference point and how high, metres; cosine and sine of the pitch;
half the width and height of the picture at depth 1.
"""


class Objects(NamedTuple):
    """The k objects of each of n cars, in the order of the reference: racers, obstacles, bots.

    Attributes:
        xy: Metres. Shape (n, k, 2).
        footprint_m: Length and width of crash rectangles. Shape (k, 2).
        distance_m: In the car's driving direction. Shape (n, k).
        speed_mps: As reward functions are told. Shape (k,).
        tells_heading: To them; that of a box is always 0. Shape (k,).
    """

    xy: Floats
    yaw_rad: Floats
    footprint_m: Floats
    distance_m: Floats
    from_center_m: Floats
    left_of_center: Bools
    speed_mps: Floats
    tells_heading: Bools


@kernel
def closest(distance_m: Floats, cars: Ints, along_m: Floats) -> tuple[Ints, Ints]:
    """Indices of the objects before and after c cars, round the end of the lap.

    Of equally far objects the last counts as before a car, the first as after it.
    """
    previous, following = np.empty(len(cars), np.int64), np.empty(len(cars), np.int64)
    for i in range(len(cars)):
        there_m, here_m = distance_m[cars[i]], along_m[i]
        before, after, first, last = -1, -1, 0, 0
        for k in range(len(there_m)):
            if there_m[k] < there_m[first]:
                first = k
            if there_m[k] >= there_m[last]:
                last = k
            if there_m[k] <= here_m and (before < 0 or there_m[k] >= there_m[before]):
                before = k
            if there_m[k] > here_m and (after < 0 or there_m[k] < there_m[after]):
                after = k
        previous[i] = before if before >= 0 else last
        following[i] = after if after >= 0 else first
    return previous, following


def in_camera(
    objects: tuple[Floats, Floats, Floats],
    cars: Ints,
    which: Ints,
    front_xy: Floats,
    heading_rad: Floats,
) -> Bools:
    """Whether a car's camera sees the centre or a floor corner of an object.

    `front_xy` is 0.14 m ahead of its origin. The camera is at its nominal place, as in the
    reference.
    """
    return _in_camera(objects, cars, which, front_xy, heading_rad, _CAMERA)


@kernel
def _in_camera(
    objects: tuple[Floats, Floats, Floats],
    cars: Ints,
    which: Ints,
    front_xy: Floats,
    heading_rad: Floats,
    camera: tuple[float, float, float, float, float, float],
) -> Bools:
    xy, yaw_rad, footprint_m = objects
    lens_ahead_m, lens_high_m, pitch_cos, pitch_sin, wide, high = camera
    seen = np.zeros(len(cars), np.bool_)
    for i in range(len(cars)):
        k = which[i]
        cos, sin = math.cos(heading_rad[i]), math.sin(heading_rad[i])
        x = xy[cars[i], k, 0] - front_xy[i, 0] - lens_ahead_m * cos
        y = xy[cars[i], k, 1] - front_xy[i, 1] - lens_ahead_m * sin
        turn = yaw_rad[cars[i], k] - heading_rad[i]
        turn_cos, turn_sin = math.cos(turn), math.sin(turn)
        half_m, across_m = 0.5 * footprint_m[k, 0], 0.5 * footprint_m[k, 1]
        for along, aside in ((0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            u, v = along * half_m, aside * across_m
            ahead_m = cos * x + sin * y + turn_cos * u - turn_sin * v
            left_m = cos * y - sin * x + turn_sin * u + turn_cos * v
            depth_m = pitch_cos * ahead_m + pitch_sin * lens_high_m
            up_m = pitch_sin * ahead_m - pitch_cos * lens_high_m
            if depth_m > _NEAR_M and abs(left_m) < wide * depth_m and abs(up_m) < high * depth_m:
                seen[i] = True
    return seen


# Whether a car finds a way past the objects on its track.


_CAR_M = SHAPES["race_car"].footprint_m

_STEP_M, _WIDEST_M = 0.02, 3.0
"""Of ways beside the centre line: spacing and the farthest."""

WAY_M = _CAR_M[1] + 0.1
"""Width that a car needs: nobody drives to the millimetre."""


def closed_at_m(track: Track, objects: Objects) -> Floats:
    """Where along the lap objects first leave a car no way, metres; NaN for nowhere.

    A way is straight ahead and `WAY_M` wide, with its middle on the road.
    """
    ways_m = np.arange(-_WIDEST_M, _WIDEST_M + _STEP_M, _STEP_M)
    found = np.full(len(objects.distance_m), np.nan)
    side_m = np.where(objects.left_of_center, 1.0, -1.0) * objects.from_center_m
    apart_m = (objects.footprint_m[:, 1] + WAY_M) / 2
    for car, places_m in enumerate(objects.distance_m):
        x, y, yaw_rad = track.pose_at(places_m).T[:, :, None]
        points = np.stack([x - np.sin(yaw_rad) * ways_m, y + np.cos(yaw_rad) * ways_m], axis=-1)
        road = track.on_road(points)
        road[:, [0, -1]] = False
        for each in np.argsort(places_m):
            ahead_m = places_m - places_m[each]
            if track.closed:
                ahead_m = ahead_m % track.length_m
            near = (ahead_m >= 0.0) & (ahead_m < objects.footprint_m[each, 0] + _CAR_M[0])
            free = np.abs(ways_m - side_m[car, near, None]) >= apart_m[near, None]
            # Beyond an edge of the road there may be another part of it.
            off_m = ways_m[~road[each]]
            left_m, right_m = off_m[off_m > 0.0].min(), off_m[off_m <= 0.0].max()
            if not (free.all(axis=0) & (right_m < ways_m) & (ways_m < left_m)).any():
                found[car] = places_m[each]
                break
    return found

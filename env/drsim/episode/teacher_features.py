"""What a teacher drives by: all that decides how to go on, known exactly, in every kind of race.

A teacher learns from these numbers instead of camera pictures; a camera policy then learns from it.
"""

from typing import NamedTuple

import numpy as np

from drsim.arrays import Floats, Ints, Singles
from drsim.car.car_parameters import MAX_SPEED_MPS, MAX_STEERING_DEG
from drsim.race.solids import SHAPES
from drsim.race.traffic import Traffic
from drsim.track.track import Track

_AHEAD_M = (0.3, 0.6, 0.9, 1.2, 1.6, 2.0, 2.5, 3.0, 4.0, 5.0)
"""The centre line is given this far ahead: more closely where the car will be first."""

_OBJECTS = 4
"""How many objects are given. Two in a row decide how to pass the first one; more of them come into
reach only where they stand closer than the rules of the races put them."""

_HORIZON_M = 6.0
"""Objects farther ahead are not given: at 4 m/s that is a second and a half."""

_PASSED_M = -0.9
"""Objects farther behind are not given. Half a box and the whole car behind its reference point are
0.55 m; the rest is for cars that stand across the road."""

_FAST_RAD_S = 4.0
"""A yaw rate that a car hardly exceeds."""

_LONG_STEPS = 300
"""A slow lap of a usual track."""

_OWN, _EACH = 12, 9

EPISODE_DIMS = 2
"""How many of the last columns tell about the episode: what a critic needs to expect its end. They
do not tell how to drive, and no camera shows them, so a policy is better off without them."""

TEACHER_DIMS = _OWN + 2 * len(_AHEAD_M) + _EACH * _OBJECTS + EPISODE_DIMS
"""Length of the features of one car."""

_CAR_WIDTH_M = SHAPES["race_car"].footprint_m[1]


class CarsNow(NamedTuple):
    """What is known of k cars.

    Attributes:
        cars: Their numbers. Shape (k,).
        backward: Index of each car's own into the tracks. Shape (k,).
        poses: Their reference points, metres, and yaws, radians. Shape (k, 3).
        velocity: As `CarBatch.velocity`. Shape (k, 3).
        wheel_rad: How far the front wheels are turned to the left. Shape (k,).
        requests: Steering in degrees and speed in m/s that were asked for last. Shape (k, 2).
        along_m: Where they are along the centre line. Shape (k,).
        track_width_m: Width of the road there. Shape (k,).
        progress: Percent of the lap. Shape (k,).
        steps: Steps of the episode. Shape (k,).
    """

    cars: Ints
    backward: Ints
    poses: Floats
    velocity: Floats
    wheel_rad: Floats
    requests: Floats
    along_m: Floats
    track_width_m: Floats
    progress: Floats
    steps: Ints


def teacher_features(
    tracks: tuple[Track, Track], now: CarsNow, traffic: Traffic | None, speeds_mps: Floats
) -> Singles:
    """Features of each car for a teacher, mostly within -1 .. 1.

    Lengths along the lap are along the centre line in the car's own driving direction, and left is
    positive, so that both directions look alike. A car is at its reference point, 0.14 m ahead of
    its origin. In this order:

    | columns | what |
    | --- | --- |
    | 0 | offset from the centre line in half widths of the road |
    | 1 | half the width of the road, metres |
    | 2, 3 | sine and cosine of the heading against the centre line |
    | 4, 5 | speed forward, as a share of 4 m/s, and to the left, m/s |
    | 6 | yaw rate as a share of 4 rad/s |
    | 7 | angle of the front wheels as a share of 30 degrees |
    | 8, 9 | the last request: steering / 30 degrees, speed / 4 m/s; 0 at the start |
    | 10, 11 | sine and cosine of the place on the lap as an angle |
    | 12 to 31 | for ten distances ahead, the point of the centre line: forward and left of the car, each as a share of that distance |
    | 32 to 67 | four objects, nine columns each, see below |
    | 68, 69 | of the episode: progress as a share of a lap, steps / 300 |

    Objects from 0.9 m behind to 6 m ahead along the lap are given, the hindmost first; those beyond
    the four are left out. Columns of each, all 0 but the second for none:

    | column | what |
    | --- | --- |
    | 0 | 1 for an object |
    | 1 | distance ahead along the lap / 6 m, negative behind; 1 for none |
    | 2, 3 | its centre forward of the car / 6 m, and to the left of it / 2 m, at most 2 |
    | 4 | its offset from the centre line less that of the car, metres |
    | 5, 6 | room between it and the left and the right edge of the road, less the width of a car, metres |
    | 7 | its speed along the lap less that of the car / 4 m/s |
    | 8 | its speed to the left, across the lap, m/s |

    `tracks` are the track as given, and reversed. `speeds_mps` are those of all cars, shape (n,).
    Shape (k, TEACHER_DIMS).
    """  # noqa: E501
    rows = np.zeros((len(now.cars), TEACHER_DIMS), np.float32)
    for direction, track in enumerate(tracks):
        mine = np.flatnonzero(now.backward == direction)
        if len(mine):
            these = CarsNow._make(column[mine] for column in now)
            rows[mine] = _one_way(track, these, traffic, speeds_mps)
    return rows


def _one_way(track: Track, now: CarsNow, traffic: Traffic | None, speeds_mps: Floats) -> Floats:
    """The features of cars that drive in the direction of `track`."""
    k = len(now.cars)
    places_m = now.along_m[:, None] + np.array((0.0, *_AHEAD_M))
    line = track.pose_at(places_m.ravel()).reshape(k, -1, 3)
    road_rad = line[:, 0, 2]
    offset_m = -_turned(line[:, :1, :2] - now.poses[:, None, :2], road_rad)[:, 0, 1]
    against = now.poses[:, 2] - road_rad
    forward_mps, left_mps, yaw_rad_s = now.velocity.T
    lap = 2.0 * np.pi * now.along_m / track.length_m
    own = [
        2.0 * offset_m / now.track_width_m,
        now.track_width_m / 2.0,
        np.sin(against),
        np.cos(against),
        forward_mps / MAX_SPEED_MPS,
        left_mps,
        yaw_rad_s / _FAST_RAD_S,
        np.degrees(now.wheel_rad) / MAX_STEERING_DEG,
        now.requests[:, 0] / MAX_STEERING_DEG,
        now.requests[:, 1] / MAX_SPEED_MPS,
        np.sin(lap),
        np.cos(lap),
    ]
    ahead = _turned(line[:, 1:, :2] - now.poses[:, None, :2], now.poses[:, 2])
    ahead /= np.array(_AHEAD_M)[:, None]
    along_mps = forward_mps * np.cos(against) - left_mps * np.sin(against)
    objects = _objects(track, now, (offset_m, along_mps), traffic, speeds_mps)
    episode = [now.progress / 100.0, now.steps / _LONG_STEPS]
    return np.column_stack([*own, ahead.reshape(k, -1), objects, *episode])


def _objects(
    track: Track,
    now: CarsNow,
    car: tuple[Floats, Floats],
    traffic: Traffic | None,
    speeds_mps: Floats,
) -> Floats:
    """The objects of each car, whose offset and speed along the lap `car` are.

    Shape (k, _EACH * _OBJECTS).
    """
    k = len(now.cars)
    told = np.zeros((k, _OBJECTS, _EACH))
    told[:, :, 1] = 1.0
    if traffic is None:
        return told.reshape(k, -1)
    offset_m, along_mps = car
    gap_m = traffic.gap_m(now.cars, now.along_m)
    near = (gap_m > _PASSED_M) & (gap_m < _HORIZON_M)
    order = np.argsort(np.where(near, gap_m, np.inf), axis=1)[:, :_OBJECTS]
    row = np.arange(k)[:, None]
    which = now.cars[:, None], order
    objects = traffic.objects()
    gap_m, near = gap_m[row, order], near[row, order]
    side = np.where(objects.left_of_center[which], 1.0, -1.0)
    aside_m = side * objects.from_center_m[which]
    taken_m = objects.footprint_m[order, 1] / 2.0 + _CAR_WIDTH_M
    half_m = traffic.track_width_m[which] / 2.0
    speed_mps = traffic.moving_mps(speeds_mps)[which]
    road_rad = track.pose_at(objects.distance_m[which].ravel())[:, 2].reshape(order.shape)
    drift = objects.yaw_rad[which] - road_rad
    place = _turned(objects.xy[which] - now.poses[:, None, :2], now.poses[:, 2])
    columns = [
        np.ones_like(gap_m),
        gap_m / _HORIZON_M,
        place[..., 0] / _HORIZON_M,
        np.clip(place[..., 1] / 2.0, -2.0, 2.0),
        aside_m - offset_m[:, None],
        half_m - aside_m - taken_m,
        half_m + aside_m - taken_m,
        (speed_mps * np.cos(drift) - along_mps[:, None]) / MAX_SPEED_MPS,
        speed_mps * np.sin(drift),
    ]
    told[:, : order.shape[1]][near] = np.stack(columns, axis=-1)[near]
    return told.reshape(k, -1)


def _turned(away: Floats, yaw_rad: Floats) -> Floats:
    """Vectors, shape (k, m, 2), as seen by k cars with these headings: forward and left."""
    cos, sin = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    x, y = away[..., 0], away[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)

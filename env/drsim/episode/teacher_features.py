"""What a teacher drives by: all that decides how to go on, known exactly."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drsim.arrays import Floats, Ints, Singles
from drsim.car.car_parameters import MAX_SPEED_MPS, MAX_STEERING_DEG
from drsim.race.solids import SHAPES
from drsim.race.traffic import Traffic
from drsim.track.track import Track

_AHEAD_M = (0.3, 0.6, 0.9, 1.2, 1.6, 2.0, 2.5, 3.0, 4.0, 5.0)
_OBJECTS = 4
"""Two in a row decide how to pass the first."""

_HORIZON_M = 6.0
"""At 4 m/s a second and a half."""

_PASSED_M = -0.9
"""Half a box and the car behind its reference point are 0.55 m."""

_FAST_RAD_S = 4.0
_LONG_STEPS = 300
_OWN, _EACH = 12, 9

TEACHER_PLACE, CRITIC_PLACE = slice(10, 12), slice(4, 6)
"""Columns of the place on the lap, which says nothing about another track."""

EPISODE_DIMS = 2
"""The last columns: for a critic, not for driving."""

TEACHER_DIMS = _OWN + 2 * len(_AHEAD_M) + _EACH * _OBJECTS + EPISODE_DIMS
_CAR_WIDTH_M = SHAPES["race_car"].footprint_m[1]


class CarsNow(NamedTuple):
    """What is known of k cars. Shape (k,) unless given.

    Attributes:
        way: Index into the tracks.
        poses: Reference points, metres, and yaws, radians. Shape (k, 3).
        velocity: As `CarBatch.velocity`. Shape (k, 3).
        wheel_rad: To the left.
        requests: Degrees and m/s. Shape (k, 2).
    """

    cars: Ints
    way: Ints
    poses: Floats
    velocity: Floats
    wheel_rad: Floats
    requests: Floats
    along_m: Floats
    track_width_m: Floats
    progress: Floats
    steps: Ints


def teacher_features(
    tracks: Sequence[Track], now: CarsNow, traffic: Traffic | None, speeds_mps: Floats
) -> Singles:
    """Features of each car for a teacher, mostly within -1 .. 1. Shape (k, TEACHER_DIMS).

    Lengths are along the lap in the car's own direction, from its reference point, 0.14 m ahead of
    its origin; left is positive. Columns:

    - 0: offset from the centre line in half widths of the road; 1: half a width, metres
    - 2, 3: sine and cosine of the heading against the centre line
    - 4, 5: speed forward / 4 m/s, and to the left, m/s; 6: yaw rate / 4 rad/s
    - 7: angle of the front wheels / 30 degrees
    - 8, 9: last request: steering / 30 degrees, speed / 4 m/s; 0 at the start
    - 10, 11: sine and cosine of the place on the lap
    - 12 to 31: ten points of the centre line ahead: forward and left / distance
    - 32 to 67: four objects, nine columns each
    - 68, 69: progress / a lap, steps / 300

    Of objects from 0.9 m behind to 6 m ahead, the hindmost first; 0 for none but in the second:

    - 0: 1 for an object; 1: distance / 6 m, 1 for none
    - 2, 3: its centre forward / 6 m, and to the left / 2 m, at most 2
    - 4: its offset from the centre line less that of the car, metres
    - 5, 6: room to its left and right on the road, less a car's width, metres
    - 7, 8: its speed along the lap less that of the car / 4 m/s, and to the left, m/s
    """
    rows = np.zeros((len(now.cars), TEACHER_DIMS), np.float32)
    for way in np.unique(now.way):
        mine = np.flatnonzero(now.way == way)
        these = CarsNow._make(column[mine] for column in now)
        rows[mine] = _one_way(tracks[way], these, traffic, speeds_mps)
    return rows


def _one_way(track: Track, now: CarsNow, traffic: Traffic | None, speeds_mps: Floats) -> Floats:
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
    cos, sin = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    x, y = away[..., 0], away[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


# Privileged information for a critic: what no camera shows.


_CRITIC_AHEAD_M = (0.3, 0.6, 1.0, 1.5, 2.0, 3.0)
_CRITIC_OBJECTS = 2
"""The nearest ahead."""

_CRITIC_HORIZON_M = 4.0
"""What is farther counts as 1."""

PRIVILEGED_DIMS = 6 + 2 * len(_CRITIC_AHEAD_M) + 2 * _CRITIC_OBJECTS


def features(
    tracks: Sequence[Track],
    cars: Ints,
    ways: Ints,
    poses: Floats,
    speed_mps: Floats,
    along_m: Floats,
    traffic: Traffic | None,
) -> Singles:
    """Features of each car for a critic. Shape (k, PRIVILEGED_DIMS).

    In order: offset from the centre line in half widths, left positive; sine and cosine of the
    heading against the line; speed in m/s; sine and cosine of the place on the lap; of the line's
    turn at six places ahead; for the two nearest objects ahead, distance / 4 m (1 for none) and
    offset in half widths.
    """
    rows = np.zeros((len(cars), PRIVILEGED_DIMS), np.float32)
    for way in np.unique(ways):
        mine, track = np.flatnonzero(ways == way), tracks[way]
        where = track.locate(poses[mine, :2])
        half_m = where.track_width_m / 2
        side = np.where(where.left_of_center, 1.0, -1.0)
        heading = track.pose_at(along_m[mine])[:, 2]
        against = poses[mine, 2] - heading
        lap = 2.0 * np.pi * along_m[mine] / track.length_m
        ahead_m = (along_m[mine, None] + np.array(_CRITIC_AHEAD_M)).ravel()
        turn = track.pose_at(ahead_m)[:, 2].reshape(len(mine), -1) - heading[:, None]
        columns = [
            side * where.from_center_m / half_m,
            np.sin(against),
            np.cos(against),
            speed_mps[mine],
            np.sin(lap),
            np.cos(lap),
        ]
        known = np.column_stack([*columns, np.sin(turn), np.cos(turn)])
        rows[mine, : known.shape[1]] = known
        rows[mine, known.shape[1] :] = _objects_for_critic(
            track, cars[mine], along_m[mine], half_m, traffic
        )
    return rows


def _objects_for_critic(
    track: Track, cars: Ints, along_m: Floats, half_m: Floats, traffic: Traffic | None
) -> Floats:
    told = np.tile([1.0, 0.0], (len(cars), _CRITIC_OBJECTS))
    if traffic is None:
        return told
    ahead_m = (traffic.distance_m[cars] - along_m[:, None]) % track.length_m
    objects = traffic.objects()
    side = np.where(objects.left_of_center[cars], 1.0, -1.0)
    offset = side * objects.from_center_m[cars] / half_m[:, None]
    order = np.argsort(ahead_m, axis=1)[:, :_CRITIC_OBJECTS]
    near = np.take_along_axis(ahead_m, order, axis=1)
    seen = near < _CRITIC_HORIZON_M
    count = order.shape[1]
    told[:, 0 : 2 * count : 2] = np.where(seen, near / _CRITIC_HORIZON_M, 1.0)
    told[:, 1 : 2 * count : 2] = np.where(seen, np.take_along_axis(offset, order, axis=1), 0.0)
    return told

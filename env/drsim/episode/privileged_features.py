"""Privileged information for a critic: what no camera shows."""

import numpy as np

from drsim.arrays import Floats, Ints, Singles
from drsim.race.traffic import Traffic
from drsim.track.track import Track

_AHEAD_M = (0.3, 0.6, 1.0, 1.5, 2.0, 3.0)
_OBJECTS = 2
"""The nearest ahead."""

_HORIZON_M = 4.0
"""What is farther counts as 1."""

PRIVILEGED_DIMS = 6 + 2 * len(_AHEAD_M) + 2 * _OBJECTS


def features(
    tracks: tuple[Track, Track],
    cars: Ints,
    backward: Ints,
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
    for direction, track in enumerate(tracks):
        mine = np.flatnonzero(backward == direction)
        if not len(mine):
            continue
        where = track.locate(poses[mine, :2])
        half_m = where.track_width_m / 2
        side = np.where(where.left_of_center, 1.0, -1.0)
        heading = track.pose_at(along_m[mine])[:, 2]
        against = poses[mine, 2] - heading
        lap = 2.0 * np.pi * along_m[mine] / track.length_m
        ahead_m = (along_m[mine, None] + np.array(_AHEAD_M)).ravel()
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
        rows[mine, known.shape[1] :] = _objects(track, cars[mine], along_m[mine], half_m, traffic)
    return rows


def _objects(
    track: Track, cars: Ints, along_m: Floats, half_m: Floats, traffic: Traffic | None
) -> Floats:
    told = np.tile([1.0, 0.0], (len(cars), _OBJECTS))
    if traffic is None:
        return told
    ahead_m = (traffic.distance_m[cars] - along_m[:, None]) % track.length_m
    objects = traffic.objects()
    side = np.where(objects.left_of_center[cars], 1.0, -1.0)
    offset = side * objects.from_center_m[cars] / half_m[:, None]
    order = np.argsort(ahead_m, axis=1)[:, :_OBJECTS]
    near = np.take_along_axis(ahead_m, order, axis=1)
    seen = near < _HORIZON_M
    count = order.shape[1]
    told[:, 0 : 2 * count : 2] = np.where(seen, near / _HORIZON_M, 1.0)
    told[:, 1 : 2 * count : 2] = np.where(seen, np.take_along_axis(offset, order, axis=1), 0.0)
    return told

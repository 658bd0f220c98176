"""Where cars are put: on lanes in either direction, and aside."""

import numpy as np
import pytest

from drsim.episode.placing import Placing
from drsim.track.appearance import look_of
from drsim.track.track import CENTER, INNER, LANES, OUTER
from drsim.track.ways import Ways
from drsim.track.worlds import known_worlds, load_track

TRACK = load_track("reinvent_base")


def placing(track, backward) -> Placing:
    ways = Ways([track], len(backward))
    ways.choose(np.arange(len(backward)), 0, np.asarray(backward) == 1)
    return Placing(ways)


def test_each_car_is_put_on_its_lane_in_its_own_direction() -> None:
    where = placing(TRACK, [0, 1, 1])
    cars, fraction = np.arange(3), np.array([0.2, 0.2, 0.7])
    lanes = np.array([INNER, OUTER, CENTER])

    poses = where.on_each(cars, fraction, lanes)

    for car, lane in enumerate(lanes):
        track = where.ways.of(car)
        expected = track.pose_at(fraction[car : car + 1] * track.length_m, LANES[lane])[0]
        np.testing.assert_array_equal(poses[car], expected)


@pytest.mark.parametrize("backward", [0, 1])
def test_the_nearer_lane_of_a_point_on_a_lane_is_that_lane(backward) -> None:
    cars, fraction = np.arange(40), np.linspace(0.0, 0.99, 40)
    where = placing(TRACK, np.full(40, backward))
    lanes = np.where(cars % 2, INNER, OUTER)

    points = where.on_each(cars, fraction, lanes)[:, :2]

    np.testing.assert_array_equal(where.nearer_lane(cars, fraction, points), lanes)


@pytest.mark.parametrize("world", known_worlds())
def test_a_car_that_is_put_aside_stands_off_every_road_and_within_the_walls(world) -> None:
    track = load_track(world)
    cars = np.arange(200)
    where = placing(track, cars % 2)

    poses = where.aside(cars, np.linspace(0.0, 1.0, 200))

    half_m = np.hypot(0.32, 0.2) / 2
    turn = np.linspace(0.0, 2 * np.pi, 8)
    around = half_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    corners = poses[:, None, :2] + around
    assert not track.on_road(corners).any()
    low_x, high_x, low_y, high_y = look_of(world).walls.around(track.bounds)
    assert low_x < corners[..., 0].min() < corners[..., 0].max() < high_x
    assert low_y < corners[..., 1].min() < corners[..., 1].max() < high_y

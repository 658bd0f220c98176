"""Gymnasium's pictures: the car and what it meets, from behind and from above."""

import copy
import math

import numpy as np
import pytest

from drsim.episode.simulation import Simulation
from drsim.race.race import Race, race_of_name
from drsim.race.solids import SHAPES
from drsim.track.track import Track
from drsim.viewing.car_eye import FollowingCamera, lens_above
from drsim.viewing.placed_objects import PlacedObject
from drsim.viewing.rendering import Viewer
from drsim.viewing.world_view import WorldView

ORANGE = (255.0, 159.9, 9.9)


@pytest.fixture(scope="module")
def square() -> Track:
    """A square road 1 m wide around the origin."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    return Track("square", 2.0 * corners, 1.5 * corners, 2.5 * corners, closed=True)


def started(track: Track, race: Race | None = None, num_cars: int = 1) -> Simulation:
    simulation = Simulation(
        track,
        num_cars=num_cars,
        reward_function=lambda params: 1.0,
        num_threads=1,
        race=race or Race(),
    )
    simulation.reset(np.arange(num_cars), np.full(num_cars, 0.1))
    return simulation


@pytest.fixture(scope="module")
def driven(square):
    """A car that has driven to the left from rest."""
    simulation = started(square)
    for _ in range(6):
        simulation.step(np.array([30.0]), np.array([0.5]))
    yield simulation
    simulation.close()


@pytest.fixture(scope="module")
def empty(square):
    view = WorldView(square, threads=1)
    yield view
    view.close()


def middle_of_difference(picture, other):
    rows, columns = np.nonzero((picture != other).any(axis=2))
    return rows.mean(), columns.mean()


def test_from_above_the_car_is_where_it_is(driven, square, empty):
    picture = Viewer(driven, "top").picture(0)

    lens = lens_above(square, (480, 640))
    row, column = middle_of_difference(picture, empty.frame(lens, []))
    pixel_m = 2.0 * lens.pos[2] * math.tan(0.5 * lens.field_of_view_rad) / 640
    x, y, _ = driven.poses[0]
    assert picture.shape == (480, 640, 3)
    assert column == pytest.approx(320 + x / pixel_m, abs=4)
    assert row == pytest.approx(240 - y / pixel_m, abs=4)


def test_from_behind_the_car_is_in_the_lower_middle_and_its_wheels_turn(driven, empty):
    picture = Viewer(driven, "chase").picture(0)

    x, y, yaw = driven.poses[0].tolist()
    lens = FollowingCamera().lens((x, y, yaw))
    row, column = middle_of_difference(picture, empty.frame(lens, []))
    assert column == pytest.approx(320, abs=15)
    assert 250 < row < 400
    steering_rad, rolled_m = driven.wheels[0].tolist()
    assert math.radians(10) < steering_rad < math.radians(31)
    assert rolled_m == pytest.approx(6 / 15 * 0.5, rel=0.5)
    car = SHAPES["race_car"]
    straight = empty.frame(lens, [PlacedObject(car, (x, y, yaw), rolled_m=rolled_m)])
    turned = empty.frame(lens, [PlacedObject(car, (x, y, yaw), None, steering_rad, rolled_m)])
    np.testing.assert_array_equal(picture, turned)
    assert (picture != straight).any()


def test_a_copy_that_was_made_while_the_camera_swings_shows_the_same(driven):
    viewer = Viewer(driven, "chase")
    viewer.picture(0)

    twin = copy.deepcopy(viewer)

    np.testing.assert_array_equal(twin.picture(0), viewer.picture(0))


def test_another_racer_is_orange(square, empty):
    racers = started(square, Race(racers=2), num_cars=2)

    picture = Viewer(racers, "chase").picture(1)

    (x, y, yaw), (ahead_x, ahead_y, ahead_yaw) = racers.poses[::-1].tolist()
    car = SHAPES["race_car"]
    mine, other = (
        PlacedObject(car, (x, y, yaw)),
        PlacedObject(car, (ahead_x, ahead_y, ahead_yaw), ORANGE),
    )
    lens = FollowingCamera().lens((x, y, yaw))
    np.testing.assert_array_equal(picture, empty.frame(lens, [mine, other]))
    orange = (np.abs(picture.astype(int) - (200, 120, 10)) < 60).all(axis=2)
    assert orange.sum() > 200
    racers.close()


def test_boxes_are_seen_from_above(square, empty):
    simulation = started(square, race_of_name("object_avoidance"))

    picture = Viewer(simulation, "top").picture(0)

    lens = lens_above(square, (480, 640))
    pose = tuple(simulation.poses[0].tolist())
    alone = empty.frame(lens, [PlacedObject(SHAPES["race_car"], pose)])
    assert (picture != alone).any(axis=2).sum() > 6 * 100
    simulation.close()

"""Sensor suites: what can be carried, what it looks like, and the filters of the lidar."""

import gymnasium as gym
import numpy as np
import pytest

from drsim.sensing.sensors import CAMERAS, LIDARS, Sensors, sensors_of

INF = np.inf


def scan_of(sectors, count=8):
    """One scan whose sectors hold one distance each, the others infinite."""
    rays_m = np.full((count, 64 // count), INF, np.float32)
    for sector, distance_m in sectors.items():
        rays_m[sector, sector % (64 // count)] = distance_m
    return rays_m.reshape(1, 64)


@pytest.mark.parametrize("camera", CAMERAS)
def test_one_camera_is_a_box_of_grey_frames(camera):
    space = Sensors((camera,)).space()

    eyes = 2 if camera == "STEREO_CAMERAS" else 1
    assert space == gym.spaces.Box(0, 255, (120, 160, eyes), np.uint8)


@pytest.mark.parametrize(("lidar", "values"), list(zip(LIDARS, (64, 8, 64), strict=True)))
def test_a_camera_with_a_lidar_is_a_dict_in_sorted_order(lidar, values):
    sensors = Sensors((lidar, "STEREO_CAMERAS"))

    space = sensors.space()

    assert isinstance(space, gym.spaces.Dict)
    assert list(space) == sorted((lidar, "STEREO_CAMERAS"))
    assert space[lidar].shape == (values,) == (sensors.num_values,)


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        ((), "exactly one of"),
        (("LIDAR",), "exactly one of"),
        (("FRONT_FACING_CAMERA", "STEREO_CAMERAS"), "exactly one of"),
        (("observation", "LIDAR", "SECTOR_LIDAR"), "at most one of"),
        (("observation", "SONAR"), "SONAR is not a sensor"),
    ],
)
def test_a_suite_that_no_car_carries_is_refused(names, sentence):
    with pytest.raises(ValueError, match=sentence):
        Sensors(names)


@pytest.mark.parametrize(
    "numbers",
    [
        {"num_sectors": 7},
        {"num_sectors": 0},
        {"values_per_sector": 0},
        {"clipping_m": 0.0},
        {"clipping_m": float("nan")},
    ],
)
def test_numbers_that_make_no_bins_are_refused(numbers):
    with pytest.raises(ValueError, match=r"must"):
        Sensors(("observation", "DISCRETIZED_SECTOR_LIDAR"), **numbers)


@pytest.mark.parametrize("names", ["LEFT_CAMERA", ["LEFT_CAMERA"], Sensors(("LEFT_CAMERA",))])
def test_sensors_can_be_named_in_several_ways(names):
    assert sensors_of(names) == Sensors(("LEFT_CAMERA",))


def test_lidar_is_clipped_to_15_cm_and_1_m_and_infinity_becomes_1_m():
    sensors = Sensors(("observation", "LIDAR"))

    values = sensors.process(np.array([[0.1, 0.15, 0.7, 1.0, 5.0, INF]], np.float32))

    np.testing.assert_allclose(values, [[0.15, 0.15, 0.7, 1.0, 1.0, 1.0]])


def test_sector_lidar_says_which_eighths_have_something_within_half_a_metre():
    sensors = Sensors(("observation", "SECTOR_LIDAR"))

    values = sensors.process(scan_of({0: 0.2, 3: 0.49, 4: 0.5, 7: 3.0}))

    assert values.tolist() == [[1, 0, 0, 1, 0, 0, 0, 0]]


def test_discretized_sectors_are_one_hot_without_a_bin_for_nothing():
    sensors = Sensors(("observation", "DISCRETIZED_SECTOR_LIDAR"))

    values = sensors.process(scan_of({0: 0.15, 1: 0.25, 2: 1.99, 3: 2.0, 4: 7.0}))

    ones = np.argwhere(values.reshape(8, 8)).tolist()
    assert ones == [[0, 0], [1, 1], [2, 7]]  # bins of 0.25 m; 2 m and more is nothing


def test_discretized_sectors_follow_their_settings():
    sensors = Sensors(
        ("observation", "DISCRETIZED_SECTOR_LIDAR"),
        num_sectors=4,
        values_per_sector=2,
        clipping_m=1.0,
    )

    values = sensors.process(scan_of({1: 0.7, 2: 0.3}, count=4))

    assert values.tolist() == [[0, 0, 0, 1, 1, 0, 0, 0]]


def test_what_the_filters_give_lies_in_the_declared_space():
    rays_m = np.random.default_rng(0).uniform(0.1, 14.0, (50, 64)).astype(np.float32)
    rays_m[rays_m > 12] = INF

    for lidar in LIDARS:
        sensors = Sensors(("observation", lidar))
        values = sensors.process(rays_m)
        assert all(sensors.space()[lidar].contains(row) for row in values)


def test_a_suite_without_lidar_gives_no_values():
    assert Sensors().process(np.ones((3, 64), np.float32)).shape == (3, 0)

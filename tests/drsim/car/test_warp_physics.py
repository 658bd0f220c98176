"""MuJoCo Warp moves cars as MuJoCo does. On the processor: what it computes is the same there.

The first run compiles Warp's kernels, 20 s of one core; later ones read them from its cache.
"""

import copy

import numpy as np
import pytest
from physics import FURTHEST_DEG, FURTHEST_M, parity

from drsim.arrays import Floats
from drsim.car.car import CarBatch
from drsim.car.conditions import Variation, no_variation

wp = pytest.importorskip("warp", reason="needs drcli[gpu]: MuJoCo Warp is not installed")
pytest.importorskip("mujoco_warp", reason="needs drcli[gpu]: MuJoCo Warp is not installed")

wp.config.optimization_level = 0  # compiles in half the time


def warp_cars(num_cars: int, **options: float) -> CarBatch:
    cars = CarBatch(num_cars, 1, physics="warp-on-cpu", **options)
    assert cars.physics == "MuJoCo Warp on the processor"
    return cars


def drive(cars: CarBatch, actions: Floats) -> CarBatch:
    """Drive actions of shape (steps, n, 2)."""
    for action in actions:
        cars.drive(*action.T)
    return cars


def random_actions(steps: int, num_cars: int) -> Floats:
    return np.random.default_rng(1).uniform([-30.0, 0.5], [30.0, 4.0], (steps, num_cars, 2))


def test_cars_are_where_mujoco_brings_them_after_a_second():
    apart = parity(8, "warp-on-cpu")

    assert apart["furthest_m"] < FURTHEST_M
    assert apart["furthest_deg"] < FURTHEST_DEG
    assert apart["median_m"] < 0.02 * FURTHEST_M


def test_a_car_drives_as_it_would_alone():
    actions = random_actions(8, 5)

    many = drive(warp_cars(5), actions)
    alone = drive(warp_cars(1), actions[:, 3:4])

    np.testing.assert_array_equal(alone.lens_pos[0], many.lens_pos[3])
    np.testing.assert_array_equal(alone.wheel_xy[0], many.wheel_xy[3])


def test_cars_with_other_grip_mass_latency_and_battery_drive_as_those_of_mujoco():
    variation = Variation(
        friction=np.array([1.0, 0.5, 1.0, 1.0]),
        mass=np.array([1.0, 1.0, 1.6, 1.0]),
        battery=np.array([1.0, 1.0, 1.0, 0.7]),
        latency_s=np.array([0.0, 0.0, 0.0, 0.09]),
        steering_trim_deg=np.zeros(4),
        steering_left=np.ones(4),
        steering_right=np.ones(4),
    )
    actions = np.tile([25.0, 3.0], (12, 4, 1))
    found = []

    for cars in (CarBatch(4, 1, longest_latency_s=0.1), warp_cars(4, longest_latency_s=0.1)):
        cars.vary(np.arange(4), variation)
        cars.place(np.arange(4), np.zeros((4, 3)))
        drive(cars, actions)
        found.append(np.column_stack([cars.origin_xy, cars.yaw_rad]))

    usual, ours = found
    np.testing.assert_allclose(ours, usual, atol=FURTHEST_M)
    assert (np.abs(usual[1:, :2] - usual[0, :2]).max(axis=1) > 4 * FURTHEST_M).all()


def test_a_car_that_does_not_move_stands_still_and_goes_on_as_before():
    actions = random_actions(6, 2)
    both, one_waits = drive(warp_cars(2), actions[:3]), drive(warp_cars(2), actions[:3])
    before = one_waits.origin_xy.copy()

    one_waits.drive(*actions[0].T, np.array([True, False]))

    np.testing.assert_array_equal(one_waits.origin_xy[1], before[1])
    assert np.hypot(*(one_waits.origin_xy - before)[0]) > 0.01

    drive(both, actions[3:])
    drive(one_waits, actions[3:])

    np.testing.assert_array_equal(one_waits.lens_pos[1], both.lens_pos[1])


def test_a_car_that_is_put_back_drives_like_a_new_one():
    actions = random_actions(5, 2)
    cars, new = drive(warp_cars(2), random_actions(4, 2)), warp_cars(2)
    cars._physics.qpos[0] = np.nan

    cars.place(np.arange(2), np.zeros((2, 3)))
    drive(cars, actions)
    drive(new, actions)

    np.testing.assert_array_equal(cars.lens_pos, new.lens_pos)
    np.testing.assert_array_equal(cars.speed, new.speed)


def test_a_copy_drives_on_as_the_original():
    actions = random_actions(6, 3)
    cars = drive(warp_cars(3, longest_latency_s=0.1), actions[:3])
    cars.vary(np.array([1]), no_variation(3)._replace(friction=np.full(3, 0.6)))

    twin = copy.deepcopy(cars)
    drive(cars, actions[3:])
    drive(twin, actions[3:])

    np.testing.assert_array_equal(twin.lens_pos, cars.lens_pos)

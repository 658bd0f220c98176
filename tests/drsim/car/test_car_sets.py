"""Named sets of car parameters, and what parameters may be."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from drsim.car.car import CarBatch
from drsim.car.car_parameters import CAR_SETS, DEFAULT_CAR, CarParameters, car_of

every_set = pytest.mark.parametrize("name", CAR_SETS)


def driven(parameters: CarParameters, steering_deg: float, speed_mps: float, steps: int):
    """Speeds after each step from rest, of one car. Shape (steps,)."""
    car = CarBatch(1, 1, parameters)
    speeds = []
    for _ in range(steps):
        car.drive(np.array([steering_deg]), np.array([speed_mps]))
        speeds.append(float(car.speed[0]))
    return np.array(speeds)


def test_the_default_is_the_calibrated_car_and_comes_first():
    assert next(iter(CAR_SETS)) == DEFAULT_CAR
    assert CAR_SETS[DEFAULT_CAR].parameters == CarParameters()


@every_set
def test_a_set_is_found_by_its_name_in_any_letter_case(name):
    assert car_of(name.upper()) is CAR_SETS[name].parameters
    assert CAR_SETS[name].name == name
    assert CAR_SETS[name].origin.endswith(".")


def test_parameters_of_your_own_are_taken_as_they_are():
    own = CarParameters(friction=0.5)

    assert car_of(own) is own


@pytest.mark.parametrize("wrong", ["2021", "release6", "", None, 2022, 0.6])
def test_an_unknown_car_is_refused_with_all_names(wrong):
    with pytest.raises(ValueError, match=r"Choose one of release-6, low-grip, 2022") as caught:
        car_of(wrong)

    assert repr(wrong) in str(caught.value)


def test_a_misspelt_car_gets_a_suggestion():
    with pytest.raises(ValueError, match=r"Did you mean release-6\?"):
        car_of("release_6")


@every_set
def test_every_car_carries_its_camera_at_about_the_same_height(name):
    heights_m = [CarBatch(1, 1, car_of(car)).lens_pos[0, 2] for car in (name, DEFAULT_CAR)]

    assert heights_m[0] == pytest.approx(heights_m[1], abs=0.002)


@every_set
def test_every_car_drives_straight_at_about_the_speed_that_it_is_asked_for(name):
    assert driven(car_of(name), 0.0, 1.0, 45)[-1] == pytest.approx(1.0, abs=0.05)


@every_set
def test_every_car_stays_on_the_floor_whatever_it_is_asked(name):
    cars = CarBatch(16, 1, car_of(name))
    random = np.random.default_rng(0)

    for _ in range(150):
        cars.drive(random.choice([-30.0, 0.0, 30.0], 16), random.choice([0.1, 4.0], 16))
        assert cars.speed.max() < 5.0
        assert (np.abs(cars.lens_pos[:, 2] - 0.133) < 0.1).all()


def test_the_car_of_2022_is_slower_to_speed_up_and_to_turn():
    default, old = car_of(DEFAULT_CAR), car_of("2022")

    assert driven(old, 0.0, 2.0, 3)[-1] < 0.6 * driven(default, 0.0, 2.0, 3)[-1]
    headings = []
    for parameters in (default, old):
        car = CarBatch(1, 1, parameters)
        for _ in range(8):
            car.drive(np.array([20.0]), np.array([1.0]))
        headings.append(float(car.yaw_rad[0]))
    assert headings[1] < 0.6 * headings[0]


def test_a_speed_lag_delays_the_speed_and_not_what_is_reached():
    slow, at_once = (driven(CarParameters(speed_lag_s=lag), 0.0, 1.0, 45) for lag in (0.3, 0.0))

    assert slow[4] < 0.8 * at_once[4]  # 1/3 s: 1 - 1/e of the speed
    assert slow[-1] == pytest.approx(at_once[-1], abs=0.02)


def test_a_copy_of_a_car_with_a_speed_lag_goes_on_like_its_original():
    car = CarBatch(2, 1, car_of("2022"))
    steering_deg, speed_mps = np.array([10.0, -20.0]), np.array([2.0, 1.0])
    for _ in range(5):
        car.drive(steering_deg, speed_mps)

    twin = copy.deepcopy(car)

    for _ in range(10):
        car.drive(steering_deg, speed_mps)
        twin.drive(steering_deg, speed_mps)
    np.testing.assert_array_equal(car.origin_xy, twin.origin_xy)
    np.testing.assert_array_equal(car.yaw_rad, twin.yaw_rad)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"friction": -0.1}, "friction is -0.1; it must be more than 0"),
        ({"traction": 0.0}, "traction is 0.0; it must be more than 0"),
        ({"speed_lag_s": -1.0}, "speed_lag_s is -1.0; it must be 0 or more"),
        ({"wheel_torque": float("nan")}, "wheel_torque is nan"),
        ({"tyre_time_s": float("inf")}, "tyre_time_s is inf"),
        ({"tyre_impedance": 1.0}, "tyre_impedance is 1.0; it must be less than 1"),
        ({"substeps": 2.5}, "substeps is 2.5; it must be a whole number"),
    ],
)
def test_parameters_that_no_car_can_have_are_refused(change, reason):
    with pytest.raises(ValueError, match=reason):
        replace(CarParameters(), **change)

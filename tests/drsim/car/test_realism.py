"""Sim-to-real extras: each does what it names, by no more than it was told, and repeatably."""

from dataclasses import fields, replace

import numpy as np
import pytest

from drsim.car.car import CarBatch
from drsim.car.car_parameters import CarParameters
from drsim.car.conditions import (
    NOMINAL,
    Conditions,
    Disturbances,
    Realism,
    Variation,
    draw_gray_overlay,
    no_variation,
)

EYES, ROWS, COLUMNS = 1, 120, 160

EVERYTHING = Realism(
    image_noise=4.0,
    brightness=0.2,
    blur_px=1.0,
    glare=0.8,
    reflections=0.7,
    camera_angle_deg=2.0,
    camera_shift_m=0.01,
    latency_s=0.02,
    latency_jitter_s=0.03,
    friction=0.2,
    mass=0.1,
    battery=0.3,
    steering_trim_deg=3.0,
    steering_lock=0.15,
    gray_overlay=1.0,
)


def each(realism: Realism, count: int = 50, first_seed: int = 0) -> list[Conditions]:
    return [realism.draw(seed) for seed in range(first_seed, first_seed + count)]


def drawn(realism: Realism, cars: int = 50, seed: int = 0) -> Disturbances:
    disturbances = Disturbances(cars)
    for car, conditions in enumerate(each(realism, cars, 1000 * seed)):
        disturbances.begin(car, conditions)
    return disturbances


def spoilt(realism: Realism, frames: np.ndarray, seed: int = 0) -> np.ndarray:
    out = frames.copy()
    drawn(realism, len(frames), seed).spoil(out, slice(0, len(frames)))
    return out


def grey(value: int, cars: int = 4) -> np.ndarray:
    return np.full((cars, EYES, ROWS, COLUMNS), value, np.uint8)


def test_nothing_is_disturbed_by_default():
    assert each(Realism()) == [NOMINAL] * 50
    assert not NOMINAL.changes_car
    assert NOMINAL.to_dict() == {}


def test_each_part_has_a_random_stream_of_its_own():
    """004-09, 003-19: switching one on, or changing its range, changes no other."""
    usual = [EVERYTHING.draw(seed) for seed in range(5)]
    for part in fields(Realism):
        without = replace(EVERYTHING, **{part.name: 0.0})
        for before, after in zip(usual, each(without, 5), strict=True):
            changed = {
                name for name, value in vars(before).items() if getattr(after, name) != value
            }
            assert len(changed) <= (2 if part.name == "steering_lock" else 1), part.name
            assert changed, part.name


def test_streams_of_parts_seeds_and_racers_are_independent():
    whole = replace(EVERYTHING, friction=0.5, mass=0.5, battery=0.5, brightness=0.5)
    names = ("friction", "mass", "battery", "brightness", "steering_left", "steering_right")
    table = np.array([[getattr(c, name) for name in names] for c in each(whole, 400)])

    correlation = np.corrcoef(table.T) - np.eye(len(names))

    assert np.abs(correlation).max() < 0.15
    assert whole.draw(1) != whole.draw(2)
    assert whole.draw(1, racer=0) != whole.draw(1, racer=1)
    assert whole.draw(1) == whole.draw(1)


@pytest.mark.parametrize(
    ("part", "value", "low", "high"),
    [
        ("battery", "battery", 0.7, 1.3),
        ("steering_trim_deg", "steering_trim_deg", -3.0, 3.0),
        ("steering_lock", "steering_left", 0.85, 1.15),
        ("steering_lock", "steering_right", 0.85, 1.15),
        ("glare", "glare", 0.0, 0.8),
        ("reflections", "reflections", 0.0, 0.7),
        ("friction", "friction", 0.8, 1.2),
        ("latency_jitter_s", "latency_s", 0.02, 0.05),
    ],
)
def test_values_are_drawn_evenly_from_their_whole_range(part, value, low, high):
    values = [getattr(conditions, value) for conditions in each(EVERYTHING, 200)]

    width = high - low
    assert low <= min(values) < low + 0.05 * width
    assert high - 0.05 * width < max(values) <= high
    assert np.mean(values) == pytest.approx((low + high) / 2, abs=0.08 * width)


def test_noise_has_the_deviation_asked_for_and_no_bias():
    noisy = spoilt(Realism(image_noise=8.0), grey(128)).astype(float)

    assert noisy.mean() == pytest.approx(128, abs=0.1)
    assert noisy.std() == pytest.approx(8.0, rel=0.02)


def test_every_frame_and_every_car_has_noise_of_its_own():
    disturbances = drawn(Realism(image_noise=8.0), 2)
    first, second = grey(128, 2), grey(128, 2)

    disturbances.spoil(first, slice(0, 2))
    disturbances.next_frames(np.arange(2))
    disturbances.spoil(second, slice(0, 2))

    pairs = [(first[0], first[1]), (first[0], second[0]), (first[1], second[0])]
    assert all(abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.03 for one, other in pairs)


def test_the_same_draw_spoils_alike():
    realism = Realism(image_noise=5.0, brightness=0.3, blur_px=1.5)
    picture = np.arange(ROWS * COLUMNS).reshape(1, 1, ROWS, COLUMNS).astype(np.uint8)

    np.testing.assert_array_equal(spoilt(realism, picture, 3), spoilt(realism, picture, 3))


def test_brightness_scales_whole_frames_within_its_share():
    bright = spoilt(Realism(brightness=0.2), grey(100, 40))

    levels = bright[:, 0, 0, 0]
    assert (bright == levels[:, None, None, None]).all()
    assert 80 <= levels.min() < 90
    assert 110 < levels.max() <= 120


def test_bright_frames_stop_at_white():
    assert spoilt(Realism(brightness=0.5), grey(250, 40)).max() == 255


def test_blur_keeps_the_mean_and_softens_an_edge():
    edge = grey(0, 8)
    edge[..., COLUMNS // 2 :] = 200

    blurred = spoilt(Realism(blur_px=3.0), edge).astype(float)

    steepest = np.abs(np.diff(blurred[:, 0], axis=2)).max(axis=(1, 2))
    assert blurred.mean() == pytest.approx(100, abs=0.5)
    assert steepest.min() < 40
    np.testing.assert_array_equal(blurred[..., :10], 0)


def test_the_gray_overlay_hides_the_top_quarter_and_fades_away_to_the_middle():
    """The middles of rows 40 and 50 are 40.5 and 50.5 of 120: weights 0.65 and 0.3167."""
    frames = grey(200, 2)
    frames[1] = 0

    draw_gray_overlay(frames)

    assert (frames[:, 0, :30] == 128).all()
    assert frames[:, 0, 40, 7].tolist() == [153, 83]
    assert frames[:, 0, 50, 7].tolist() == [177, 40]
    assert (np.diff(frames[0, 0, 30:60].astype(int), axis=0) >= 0).all()
    np.testing.assert_array_equal(frames[:, 0, 60:], grey(200, 2)[:, 0, 60:] * [[[1]], [[0]]])


def test_the_gray_overlay_lies_over_noise_and_over_its_share_of_episodes_only():
    assert (spoilt(Realism(gray_overlay=1.0, image_noise=20.0), grey(50))[:, 0, :30] == 128).all()

    half = spoilt(Realism(gray_overlay=0.5), grey(50, 200))
    overlaid = (half[:, 0, 0, 0] == 128).sum()
    assert 75 < overlaid < 125
    assert ((half[:, 0, 0, 0] == 128) | (half == 50).all(axis=(1, 2, 3))).all()


def test_a_lens_is_turned_and_moved_by_no_more_than_told():
    disturbances = drawn(Realism(camera_angle_deg=2.0, camera_shift_m=0.01))
    upright = np.tile(np.eye(3), (50, 1, 1))

    pos, mat = disturbances.lenses(np.zeros((50, 3)), upright)

    off_deg = np.degrees(np.arccos(np.clip((np.trace(mat, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert 1.0 < off_deg.max() < 2.0 * np.sqrt(3) + 0.1
    assert 0.005 < np.abs(pos).max() <= 0.01
    np.testing.assert_allclose(mat @ mat.transpose(0, 2, 1), upright, atol=1e-12)


def test_latency_lies_between_its_least_and_its_jitter():
    latency_s = drawn(Realism(latency_s=0.05, latency_jitter_s=0.02)).variation.latency_s

    assert latency_s.min() >= 0.05
    assert 0.06 < latency_s.max() <= 0.07


@pytest.mark.parametrize(
    "values",
    [
        {"image_noise": -1.0},
        {"mass": 1.0},
        {"friction": 1.5},
        {"blur_px": np.inf},
        {"glare": 1.01},
        {"reflections": np.nan},
        {"battery": 1.0},
        {"steering_trim_deg": 21.0},
        {"steering_lock": -0.1},
    ],
)
def test_values_that_no_car_can_have_are_refused(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Realism(**values)


@pytest.mark.parametrize(
    "values",
    [
        {"image_noise": -1.0},
        {"brightness": 0.0},
        {"glare": 2.0},
        {"battery": np.nan},
        {"steering_trim_deg": -25.0},
        {"steering_left": 3.0},
        {"latency_s": np.inf},
        {"camera_turn_deg": (0.0, np.nan, 0.0)},
        {"camera_shift_m": (0.0, 0.0)},
        {"pattern": -1},
    ],
)
def test_conditions_that_no_episode_can_have_are_refused(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Conditions(**values)


def variation(**values: list[float]) -> Variation:
    arrays = {name: np.array(numbers) for name, numbers in values.items()}
    return no_variation(len(next(iter(arrays.values()))))._replace(**arrays)


def driven(cars: CarBatch, steering_deg: float, speed_mps: float, steps: int) -> CarBatch:
    count = len(cars.speed)
    cars.place(np.arange(count), np.zeros((count, 3)))
    for _ in range(steps):
        cars.drive(np.full(count, steering_deg), np.full(count, speed_mps))
    return cars


def test_a_late_car_begins_to_move_later_and_a_slippery_one_turns_less():
    cars = CarBatch(3, 1, longest_latency_s=0.1)
    cars.vary(np.arange(3), variation(friction=[1.0, 1.0, 0.5], latency_s=[0.0, 0.1, 0.0]))

    first_m = driven(cars, 30.0, 3.0, 1).origin_xy[:, 0].copy()
    driven(cars, 30.0, 3.0, 16)

    assert first_m[0] > 0.002 > abs(first_m[1])
    assert cars.yaw_rad[2] < 0.8 * cars.yaw_rad[0]


def test_a_weak_battery_makes_the_car_slower_and_lazier():
    """004-09."""
    cars = CarBatch(3, 1)
    cars.vary(np.arange(3), variation(battery=[1.0, 0.5, 1.2]))

    early = driven(cars, 0.0, 3.0, 2).speed.copy()
    late = driven(cars, 0.0, 3.0, 40).speed

    assert late / late[0] == pytest.approx([1.0, 0.5, 1.2], rel=0.02)
    assert early[1] < 0.75 * early[0]
    assert early[2] > 1.02 * early[0]


def test_a_trimmed_car_turns_although_it_should_drive_straight():
    cars = CarBatch(3, 1)
    cars.vary(np.arange(3), variation(steering_trim_deg=[0.0, 3.0, -3.0]))

    straight, left, right = driven(cars, 0.0, 1.0, 20).yaw_rad

    assert abs(straight) < 1e-6
    assert left > 0.1
    assert right == pytest.approx(-left, rel=1e-3)


def test_an_unequal_lock_changes_one_side_only():
    cars = CarBatch(2, 1)
    cars.vary(np.arange(2), variation(steering_left=[1.0, 0.6]))

    usual_left, weak_left = driven(cars, 30.0, 1.0, 15).yaw_rad
    usual_right, same_right = driven(cars, -30.0, 1.0, 15).yaw_rad

    assert 0.3 * usual_left < weak_left < 0.75 * usual_left
    assert same_right == usual_right


def test_cars_go_back_to_nominal_when_the_next_episode_is_not_disturbed():
    cars, plain = CarBatch(2, 1, longest_latency_s=0.1), CarBatch(2, 1)
    everybody = np.arange(2)
    disturbed = variation(
        friction=[0.5, 1.0],
        mass=[1.3, 1.0],
        battery=[0.6, 1.0],
        latency_s=[0.1, 0.0],
        steering_trim_deg=[5.0, 0.0],
        steering_left=[0.5, 1.0],
        steering_right=[1.5, 1.0],
    )
    cars.vary(everybody, disturbed)
    beside = driven(cars, 20.0, 2.0, 10).origin_xy[1].copy()
    cars.vary(np.array([0]), no_variation(2))

    after = driven(cars, 20.0, 2.0, 10).origin_xy
    usual = driven(plain, 20.0, 2.0, 10).origin_xy

    np.testing.assert_array_equal(after, usual)
    np.testing.assert_array_equal(beside, usual[1])


def test_a_latency_that_the_cars_were_not_built_for_is_refused():
    with pytest.raises(ValueError, match="longest_latency_s"):
        CarBatch(1, 1, longest_latency_s=0.1).vary(np.array([0]), variation(latency_s=[0.2]))


@pytest.mark.parametrize(
    ("own", "as_factor"),
    [
        ({"battery": 0.7}, {"battery": [0.7]}),
        ({"steering_trim_deg": 2.0}, {"steering_trim_deg": [2.0]}),
        ({"steering_left_deg": 24.0}, {"steering_left": [0.8]}),
        ({"steering_right_deg": 33.0}, {"steering_right": [1.1]}),
    ],
)
def test_a_property_of_ones_own_car_is_a_disturbance_of_every_episode(own, as_factor):
    mine, varied = CarBatch(1, 1, CarParameters(**own)), CarBatch(1, 1)
    varied.vary(np.array([0]), variation(**as_factor))

    for angle_deg in (25.0, -25.0):
        there = driven(mine, angle_deg, 2.0, 12).origin_xy
        np.testing.assert_allclose(there, driven(varied, angle_deg, 2.0, 12).origin_xy, atol=1e-9)


def test_a_car_drives_no_faster_than_its_top_speed():
    slow, usual = CarBatch(1, 1, CarParameters(max_speed_mps=1.5)), CarBatch(1, 1)

    np.testing.assert_array_equal(
        driven(slow, 10.0, 3.0, 20).origin_xy, driven(usual, 10.0, 1.5, 20).origin_xy
    )
    assert driven(usual, 10.0, 3.0, 20).speed[0] > 2.0


@pytest.mark.parametrize(
    "values",
    [
        {"max_speed_mps": 0.1},
        {"battery": 0.0},
        {"steering_left_deg": 0.0},
        {"steering_right_deg": 70.0},
        {"steering_trim_deg": np.nan},
    ],
)
def test_cars_that_cannot_be_are_refused(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        CarParameters(**values)


def test_a_car_that_is_varied_by_nothing_drives_like_the_calibrated_one():
    varied, plain = CarBatch(1, 1, longest_latency_s=0.2), CarBatch(1, 1)
    varied.vary(np.array([0]), no_variation(1))

    np.testing.assert_array_equal(
        driven(varied, 20.0, 2.0, 10).origin_xy, driven(plain, 20.0, 2.0, 10).origin_xy
    )


def test_a_share_of_the_ranges_draws_the_same_values_so_much_smaller():
    quarter = EVERYTHING.scaled(0.25)

    assert EVERYTHING.scaled(1.0) == EVERYTHING
    assert quarter.latency_s == EVERYTHING.latency_s, "the same in every episode"
    for whole, small in zip(each(EVERYTHING), each(quarter), strict=True):
        assert small.friction - 1.0 == pytest.approx(0.25 * (whole.friction - 1.0))
        assert small.camera_turn_deg == pytest.approx([0.25 * a for a in whole.camera_turn_deg])
        assert small.pattern == whole.pattern

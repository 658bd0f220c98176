"""Sim-to-real extras: each does what it names, by no more than it was told, and repeatably."""

import numpy as np
import pytest

from drsim.car.car import CarBatch
from drsim.car.realism import Disturbances, Realism

EYES, ROWS, COLUMNS = 1, 120, 160


def drawn(realism: Realism, cars: int = 50, seed: int = 0) -> Disturbances:
    disturbances = Disturbances(cars, realism)
    random = np.random.default_rng(seed)
    for car in range(cars):
        disturbances.draw(car, random)
    return disturbances


def spoilt(realism: Realism, frames: np.ndarray, seed: int = 0) -> np.ndarray:
    out = frames.copy()
    drawn(realism, len(frames), seed).spoil(out, slice(0, len(frames)))
    return out


def grey(value: int, cars: int = 4) -> np.ndarray:
    return np.full((cars, EYES, ROWS, COLUMNS), value, np.uint8)


def test_nothing_is_disturbed_by_default():
    disturbances = drawn(Realism())

    assert (disturbances.friction == 1).all()
    assert (disturbances.mass == 1).all()
    assert (disturbances.latency_s == 0).all()
    assert not Realism().spoils_frames
    assert not Realism().moves_camera
    assert not Realism().changes_car


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


def test_a_lens_is_turned_and_moved_by_no_more_than_told():
    disturbances = drawn(Realism(camera_angle_deg=2.0, camera_shift_m=0.01))
    upright = np.tile(np.eye(3), (50, 1, 1))

    pos, mat = disturbances.lenses(np.zeros((50, 3)), upright)

    off_deg = np.degrees(np.arccos(np.clip((np.trace(mat, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert 1.0 < off_deg.max() < 2.0 * np.sqrt(3) + 0.1
    assert 0.005 < np.abs(pos).max() <= 0.01
    np.testing.assert_allclose(mat @ mat.transpose(0, 2, 1), upright, atol=1e-12)


def test_latency_lies_between_its_least_and_its_jitter():
    latency_s = drawn(Realism(latency_s=0.05, latency_jitter_s=0.02)).latency_s

    assert latency_s.min() >= 0.05
    assert 0.06 < latency_s.max() <= 0.07


@pytest.mark.parametrize(
    "values", [{"image_noise": -1.0}, {"mass": 1.0}, {"friction": 1.5}, {"blur_px": np.inf}]
)
def test_values_that_no_car_can_have_are_refused(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Realism(**values)


def test_a_late_car_begins_to_move_later_and_a_slippery_one_turns_less():
    cars = CarBatch(3, 1, longest_latency_s=0.1)
    ones = np.ones(3)
    cars.vary(
        np.arange(3),
        friction=np.array([1.0, 1.0, 0.5]),
        mass=ones,
        latency_s=np.array([0.0, 0.1, 0.0]),
    )
    cars.place(np.arange(3), np.zeros((3, 3)))

    cars.drive(np.full(3, 30.0), np.full(3, 3.0))
    first_m = cars.origin_xy[:, 0].copy()
    for _ in range(15):
        cars.drive(np.full(3, 30.0), np.full(3, 3.0))

    assert first_m[0] > 0.002 > abs(first_m[1])
    assert cars.yaw_rad[2] < 0.8 * cars.yaw_rad[0]


def test_a_car_that_is_varied_by_nothing_drives_like_the_calibrated_one():
    varied, plain = CarBatch(1, 1, longest_latency_s=0.2), CarBatch(1, 1)
    one = np.ones(1)
    varied.vary(np.array([0]), friction=one, mass=one, latency_s=np.zeros(1))

    for batch in (varied, plain):
        batch.place(np.array([0]), np.zeros((1, 3)))
        for _ in range(10):
            batch.drive(np.array([20.0]), np.array([2.0]))

    np.testing.assert_array_equal(varied.origin_xy, plain.origin_xy)

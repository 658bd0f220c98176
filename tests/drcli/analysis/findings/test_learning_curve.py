"""Falls, trends and swings of curves that are written out."""

import numpy as np
import pytest

from drcli.analysis.findings.learning_curve import (
    lasting_fall,
    noise,
    rolling,
    slope,
    still_rising,
    swings,
)

RISE = [10.0, 20.0, 33.0, 41.0, 50.0, 62.0, 69.0, 71.0, 75.0, 72.0, 78.0]


def test_a_fall_begins_at_the_first_low_value():
    fall = lasting_fall(np.array([*RISE, 12.0, 9.0, 11.0, 8.0]), 20.0, least_noise=1.5)

    assert fall is not None
    assert fall.at == len(RISE)
    assert fall.before == pytest.approx(np.mean(RISE[-5:]))
    assert fall.after == pytest.approx(10.0)


@pytest.mark.parametrize(
    "end",
    [
        [70.0, 76.0, 74.0],  # none
        [12.0, 9.0, 30.0, 55.0, 70.0, 74.0],  # it recovered
        [60.0, 58.0, 61.0],  # too little
        [12.0],  # a single one
    ],
)
def test_other_ends_are_no_lasting_fall(end):
    assert lasting_fall(np.array([*RISE, *end]), 20.0, least_noise=1.5) is None


def test_ups_and_downs_are_no_fall():
    values = np.array([60.0, 20.0, 70.0, 15.0, 65.0, 30.0, 75.0, 10.0, 60.0, 15.0, 20.0])

    assert lasting_fall(values, 20.0, least_noise=1.5) is None


def test_a_line_has_its_gain_and_no_doubt():
    line = slope(np.array([1.0, 2.0, np.nan, 4.0, 5.0]))

    assert line.gain == pytest.approx(4.0)
    assert line.count == 4
    assert line.rises


def test_noise_of_alternating_values_is_that_of_their_jumps():
    assert noise(np.array([0.0, 2.0] * 10)) == pytest.approx(2.0 / (0.6745 * 2**0.5))


def test_a_moving_mean_begins_with_what_there_is():
    assert rolling(np.array([3.0, 5.0, 10.0]), 2).tolist() == [3.0, 4.0, 7.5]


def test_a_curve_that_has_settled_no_longer_rises():
    assert still_rising(np.linspace(5.0, 40.0, 12), 2.5, 1.5)
    assert not still_rising(np.array([5.0, 20.0, 35.0] + [40.0, 41.0, 40.0] * 3), 2.5, 1.5)


def test_swings_count_jumps_and_turns():
    size, turns = swings(np.array([10.0, 30.0, 10.0, 30.0, 10.0]))

    assert size == pytest.approx(20.0 / 18.0)
    assert turns == 1.0


def test_swings_that_end_higher_by_one_jump_keep_all_others():
    size, _ = swings(np.array([20.0, 60.0] * 15))

    assert size == pytest.approx((40.0 - 40.0 / 29) / 40.0)


def test_equal_neighbours_are_no_straight_on():
    _, turns = swings(np.array([10.0, 100.0, 100.0, 100.0, 40.0, 100.0, 100.0, 20.0]))

    assert turns == 1.0


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_fall_of_huge_values_is_found_like_the_same_fall_of_small_ones():
    small = np.array([10.0, 10.1, 9.9, 10.0, 10.1, 9.9, 1.0, 1.1, 0.9, 1.0])
    usual, huge = (lasting_fall(scale * small, 0.0) for scale in (1.0, 1e299))

    assert huge.at == usual.at == 6
    assert huge.before == pytest.approx(1e299 * usual.before)
    assert huge.sigmas == pytest.approx(usual.sigmas)

"""Samples of laps."""

from fractions import Fraction
from math import comb

import pytest

from drcli.records.iteration import Laps, lap_time, paired_p, share_interval


def test_wilson_intervals_equal_published_ones():
    # Newcombe (1998), table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    assert share_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert share_interval(15, 148) == pytest.approx((0.0624, 0.1605), abs=1e-4)
    assert share_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert share_interval(1, 29) == pytest.approx((0.0061, 0.1718), abs=1e-4)
    assert share_interval(20, 20)[1] == 1.0


def test_a_sample_says_how_many_laps_are_clean_and_how_fast():
    laps = Laps(40, [7.61] * 38 + [7.93])

    assert str(laps) == "39 of 40 laps clean, median 7.61 s, slowest 7.93 s"
    assert str(laps.within(7.7)) == "38 of 40 laps clean, median 7.61 s, slowest 7.61 s"
    assert str(Laps(3, [])) == "0 of 3 laps clean"
    assert str(Laps(1, [8.0])) == "1 of 1 lap clean, 8.00 s"


def test_nine_of_ten_clean_laps_are_no_slower_than_the_90th_percentile():
    laps = Laps(12, [float(n) for n in range(1, 11)])

    assert (laps.p90_s, laps.median_s, laps.fastest_s, laps.slowest_s) == (9.0, 5.5, 1.0, 10.0)
    assert Laps(2, []).p90_s is None


def test_samples_add_up():
    assert Laps(2, [8.0]) + Laps(3, [7.0, 7.5]) == Laps(5, [8.0, 7.0, 7.5])


def test_a_time_is_told_with_its_penalties_and_resets():
    assert lap_time(7.8, 0.0, 0) == "7.80 s"
    assert lap_time(12.8, 5.0, 1) == "12.80 s = 7.80 driven + 5.00 penalty, 1 reset"
    assert lap_time(59.87, None, 9) == "59.87 s, 9 resets"  # a file of others: no penalty known


def test_p_values_of_pairs_equal_those_of_binomial_and_worked_permutations():
    assert paired_p([1] * 8 + [0] * 30) == 2 / 2**8
    assert paired_p([1] * 8 + [-1]) == pytest.approx(2 * (1 + 9) / 2**9)
    # Sums of +-1 +-2 +-3: two of eight are as far from 0 as 6, four as far as 4.
    assert (paired_p([1, 2, 3]), paired_p([-1, 2, 3])) == (2 / 8, 4 / 8)
    tail = sum(Fraction(comb(1000, k), 2**1000) for k in range(469))
    assert paired_p([150] * 532 + [-150] * 468) == pytest.approx(float(2 * tail), abs=1e-9)
    assert paired_p([0, 0]) == paired_p([]) == paired_p([4, -4]) == 1.0

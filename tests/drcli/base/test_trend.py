"""Steady growth, and what looks like it."""

import random

import pytest

from drcli.base.clock import MOST_SAMPLES, Trend


def fed(values, every_s=5.0) -> Trend:
    trend = Trend()
    for i, value in enumerate(values):
        trend.add(i * every_s, value)
    return trend


def test_a_leak_is_found_with_its_rate():
    growth = fed(600e6 + 1e6 * i for i in range(240)).growth(64e6, 0.1)

    assert growth is not None
    assert growth.per_s == pytest.approx(0.2e6)
    assert growth.end > growth.begin > 600e6


def test_a_leak_is_found_below_the_ups_and_downs_of_iterations():
    values = (600e6 + 1e6 * i + 300e6 * (i % 7) for i in range(480))

    growth = fed(values).growth(64e6, 0.1)

    assert growth is not None
    assert growth.per_s == pytest.approx(0.2e6, rel=0.1)


def test_a_leak_that_begins_late_is_found_too():
    flat = [600e6] * 2000
    leak = [600e6 + 2e6 * i for i in range(200)]

    assert fed(flat + leak).growth(64e6, 0.1) is not None


@pytest.mark.parametrize("seed", range(20))
def test_ups_and_downs_are_no_growth(seed):
    noise = random.Random(seed)

    assert fed(600e6 + noise.uniform(0, 200e6) for _ in range(500)).growth(64e6, 0.1) is None


def test_growth_at_the_beginning_only_is_over():
    values = [600e6 + 10e6 * min(i, 40) for i in range(300)]

    assert fed(values).growth(64e6, 0.1) is None


def test_a_little_growth_does_not_count():
    assert fed(600e6 + 1e4 * i for i in range(500)).growth(64e6, 0.1) is None


def test_nothing_is_said_before_there_is_enough():
    assert fed(600e6 + 50e6 * i for i in range(10)).growth(64e6) is None
    assert Trend().growth(0.0) is None


def test_any_time_fits_into_bounded_memory():
    trend = fed(600e6 + 1e5 * i for i in range(50_000))

    assert len(trend._samples) <= MOST_SAMPLES + 1
    assert trend.seconds > 0.99 * 50_000 * 5.0
    assert trend.growth(64e6, 0.1).per_s == pytest.approx(2e4, rel=0.05)

"""The clock of a watch, which must not count the time in which everything stood still."""

import pytest

from drcli.base.clock import LONGEST_STEP_S, AwakeClock, duration


def test_time_passes_while_the_clock_is_read():
    times = iter([100.0, 100.2, 101.2, 104.2])
    clock = AwakeClock(lambda: next(times))

    assert [clock(), clock(), clock()] == pytest.approx([0.2, 1.2, 4.2])


def test_a_sleep_of_the_machine_counts_for_a_few_seconds_only():
    times = iter([0.0, 1.0, 8 * 3600.0, 8 * 3600.0 + 1.0])
    clock = AwakeClock(lambda: next(times))

    assert [clock(), clock(), clock()] == pytest.approx(
        [1.0, 1 + LONGEST_STEP_S, 2 + LONGEST_STEP_S]
    )


def test_a_clock_that_runs_backwards_stands_still():
    times = iter([5000.0, 1000.0, 1001.0])
    clock = AwakeClock(lambda: next(times))

    assert [clock(), clock()] == pytest.approx([0.0, 1.0])


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0, "0 s"), (14.2, "14 s"), (600, "10 min"), (7200, "2 h"), (12_000, "3 h 20 min")],
)
def test_times_for_people(seconds, words):
    assert duration(seconds) == words

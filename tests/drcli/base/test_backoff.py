"""Waiting grows, is bounded, and ends as soon as there is a reason."""

from itertools import islice

import pytest

from drcli.base import errors
from drcli.base.clock import SLOW_GROWTH, delays_s, wait_until


def test_delays_double_up_to_the_last():
    assert list(islice(delays_s(0.05, 0.3), 5)) == [0.05, 0.1, 0.2, 0.3, 0.3]


def test_slow_growth_never_waits_longer_than_a_twentieth_of_the_time_waited_before():
    waited_s = 0.0
    for delay_s in islice(delays_s(growth=SLOW_GROWTH), 200):
        assert delay_s <= 0.05 + 0.05 * waited_s + 1e-9
        waited_s += delay_s


def test_a_condition_that_holds_is_not_waited_for():
    pauses: list[float] = []

    assert wait_until(lambda: True, patience_s=0, pause=pauses.append)
    assert pauses == []


def test_the_last_look_is_taken_exactly_when_the_patience_ends():
    now_s = 0.0

    def pause(seconds: float) -> None:
        nonlocal now_s
        now_s += seconds

    assert not wait_until(lambda: False, patience_s=0.4, clock=lambda: now_s, pause=pause)
    assert now_s == pytest.approx(0.4)


@pytest.mark.parametrize(("takes_s", "shown"), [(0.9, []), (30.0, ["Waiting for tea ..."])])
def test_the_user_is_told_once_what_takes_long(monkeypatch, takes_s, shown):
    now_s, said = 0.0, []
    monkeypatch.setattr(errors, "show", said.append)

    def pause(seconds: float) -> None:
        nonlocal now_s
        now_s += seconds

    assert wait_until(
        lambda: now_s >= takes_s,
        patience_s=60.0,
        what="Waiting for tea ...",
        clock=lambda: now_s,
        pause=pause,
    )
    assert said == shown

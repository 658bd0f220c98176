"""When scripts/bench/learn_lap_sb3.py says that a policy laps fast enough."""

import importlib
from collections.abc import Callable
from types import ModuleType

import pytest

from drcli.records.iteration import Laps

SEEDS = (7, 8)


@pytest.fixture
def bench() -> ModuleType:
    return importlib.import_module("learn_lap_sb3")


def policy(slow: dict[int, int]) -> Callable[[int, int], Laps]:
    """Laps of 8 s, but for so many of 8.1 s among those from starts of a seed."""
    return lambda count, seed: Laps(
        count, [8.1] * slow.get(seed, 0) + [8.0] * (count - slow.get(seed, 0))
    )


@pytest.mark.parametrize(
    ("slow", "expected"),
    [
        ({}, True),
        ({7: 1}, False),  # all laps of the evaluation have to be fast enough
        ({8: 2}, True),  # but only 38 of the 40 others
        ({8: 3}, False),
    ],
)
def test_a_lap_time_is_reached_by_all_evaluation_laps_and_38_of_40_others(bench, slow, expected):
    assert bench.holds(policy(slow), 8.0, SEEDS) is expected


def test_laps_that_were_not_completed_do_not_hold_a_lap_time(bench):
    assert not bench.holds(lambda count, seed: Laps(count, [7.0] * (count - 3)), 8.0, SEEDS)


def test_the_others_are_driven_only_after_an_evaluation_that_holds(bench):
    driven = []

    def drive(count: int, seed: int) -> Laps:
        driven.append((count, seed))
        return policy({7: 1})(count, seed)

    bench.holds(drive, 8.0, SEEDS)

    assert driven == [(20, 7)]

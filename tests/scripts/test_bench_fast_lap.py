"""What scripts/bench/fast_lap.py makes of its measurements."""

import importlib
from types import ModuleType

import pytest


@pytest.fixture
def bench() -> ModuleType:
    return importlib.import_module("fast_lap")


def test_a_goal_is_reached_by_the_first_checkpoint_whose_slowest_lap_is_fast_enough(bench):
    slow = bench.Result("shipped", 2, [(0, None), (900, 12.0), (1_800, None)], 30.0)
    fast = bench.Result("shipped", 1, [(0, None), (900, 9.0), (1_800, 7.4), (2_700, 9.5)], 50.0)

    figures = bench.summary([slow, fast])

    assert list(figures["until"][9.0].items()) == [(1, 900), (2, None)]
    assert figures["until"][8.0] == {1: 1_800, 2: None}
    assert figures["best_s"] == {1: 7.4, 2: 12.0}
    assert figures["cpu_s"] == 40.0


def test_the_last_third_tells_whether_laps_stay_fast(bench):
    times = [8.0, 8.0, 8.0, None, 8.5, 9.5]

    result = bench.Result("shipped", 1, list(enumerate(times)), 1.0)

    assert result.steady == 0.5


def test_each_case_changes_a_hyperparameter_that_exists(bench):
    from drcli.model.files.hyperparameters import Hyperparameters

    known = Hyperparameters.model_fields
    assert {key for change in bench.CASES.values() for key in change} <= set(known)

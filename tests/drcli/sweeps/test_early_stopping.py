"""When the trainings of a sweep are compared, and which of them go on."""

import random

import pytest

from drcli.sweeps.sweep_file import Budget, EarlyStopping, Span
from drcli.sweeps.trial_score import changed_value, comparable, kept_of, levels_of, replacements


def test_all_get_their_whole_budget_without_early_stopping():
    assert levels_of(Budget(minutes=20), EarlyStopping()) == [20.0]


def test_halving_compares_at_growing_amounts():
    halving = EarlyStopping(method="halving", first_check=0.25, reduction_factor=2)

    assert levels_of(Budget(minutes=20), halving) == [5.0, 10.0, 20.0]
    assert levels_of(Budget(iterations=3), halving) == [1.0, 2.0, 3.0]
    assert levels_of(Budget(iterations=1), halving) == [1.0]


def test_the_worst_third_of_six_ends_before_half_time():
    halving = EarlyStopping(method="halving")
    levels = levels_of(Budget(minutes=10), halving)

    assert levels[0] == 2.5
    assert kept_of(6, halving.reduction_factor) == 4


def test_a_population_is_compared_in_equal_steps():
    population = EarlyStopping(method="population", every=0.25)

    assert levels_of(Budget(steps=1000), population) == [250, 500, 750, 1000]


@pytest.mark.parametrize(
    ("count", "factor", "kept"), [(9, 3, 3), (4, 3, 2), (1, 3, 1), (2, 1.5, 2)]
)
def test_one_of_so_many_goes_on_and_one_at_least(count, factor, kept):
    assert kept_of(count, factor) == kept


VARY = {"lr": Span(1e-5, 1e-3, log=True), "batch_size": [32, 64, 128]}
OWN = {name: {"lr": 1e-4, "batch_size": 64} for name in "abcdefgh"}


def test_the_worst_quarter_copies_the_best_quarter():
    found = replacements("abcdefgh", OWN, VARY, 0.25, random.Random(1))

    assert [each.name for each in found] == ["g", "h"]
    assert {each.source for each in found} <= {"a", "b"}
    assert all(set(each.hyperparameters) == set(VARY) for each in found)


@pytest.mark.parametrize(("names", "replaced"), [("", 0), ("a", 0), ("ab", 1), ("abc", 1)])
def test_at_most_half_of_a_population_is_replaced(names, replaced):
    assert len(replacements(names, OWN, VARY, 0.5, random.Random(1))) == replaced


def test_a_number_stays_in_its_range_and_moves_to_both_sides():
    chance = random.Random(3)
    drawn = [changed_value(9e-4, VARY["lr"], chance) for _ in range(200)]

    assert all(1e-5 <= each <= 1e-3 for each in drawn)
    assert {7.2e-4, 1e-3} <= set(drawn)
    assert len(set(drawn)) > 20  # some are drawn anew


def test_a_number_of_a_list_moves_to_its_neighbours():
    chance = random.Random(3)

    assert {changed_value(64, VARY["batch_size"], chance) for _ in range(100)} == {32, 64, 128}
    assert changed_value(5, [1, 2], chance) in (1, 2)


def test_whole_numbers_stay_whole():
    drawn = [changed_value(10, Span(1, 20), random.Random(k)) for k in range(50)]

    assert all(isinstance(each, int) for each in drawn)


def test_amounts_are_told_in_words():
    assert comparable("minutes", 2.5) == "2.5 minutes"
    assert comparable("minutes", 0.25) == "15 s"
    assert comparable("steps", 12_500.0) == "12,500 steps"

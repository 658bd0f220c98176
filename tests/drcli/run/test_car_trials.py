"""Which car an imported model is said to suit."""

import pytest

from drcli.records.evaluation_task import CarTrial
from drcli.run.car_trials import best_of, chance


def trial(car, laps, progress):
    return CarTrial(car, laps, 16, progress, [9.0] * laps)


@pytest.mark.parametrize(
    ("own", "other", "best"),
    [
        ((10, 82.2), (16, 100.0), "low-grip"),
        ((14, 94.0), (14, 98.8), "release-6"),
        ((13, 94.0), (16, 100.0), "release-6"),
        ((0, 20.0), (0, 60.0), "release-6"),
    ],
)
def test_another_car_is_praised_only_for_more_laps_than_by_chance(own, other, best):
    trials = [trial("release-6", *own), trial("low-grip", *other)]

    assert best_of(trials, "release-6") == best
    assert best_of(trials[1:], "release-6") == "low-grip"


@pytest.mark.parametrize(("cars", "best"), [(2, "low-grip"), (5, "release-6")])
def test_of_many_cars_the_one_that_seems_best_needs_more_laps(cars, best):
    others = [trial(f"other-{number}", 11, 80.0) for number in range(cars - 2)]
    trials = [trial("release-6", 11, 80.0), trial("low-grip", 16, 100.0), *others]

    assert best_of(trials, "release-6") == best
    assert best_of(trials[:1], "release-6") == "release-6"


def test_the_chance_is_that_of_fishers_exact_test():
    assert chance(3, 1, 4) == pytest.approx(17 / 70)  # the lady who tastes tea
    assert chance(4, 4, 4) == 1.0

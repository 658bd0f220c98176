"""Curves of block characters."""

import pytest

from drcli.cli.show import curve, marks


def test_a_curve_rises_from_zero_to_its_greatest_value():
    drawn = curve([0, 1, 2, 3, 4, 5, 6, 7], 8)

    assert drawn == "▁▂▃▄▅▆▇█"


def test_a_curve_with_a_given_top_leaves_room_above():
    drawn = curve([50.0, 100.0], 8, top=100.0)

    assert drawn == "▅█"


def test_values_above_the_top_fill_their_character():
    drawn = curve([150.0], 8, top=100.0)

    assert drawn == "█"


def test_a_curve_of_negative_values_starts_at_the_least():
    drawn = curve([-4.0, 0.0], 8)

    assert drawn == "▁█"


def test_more_values_than_characters_are_averaged():
    drawn = curve([0, 0, 7, 7, 3, 4], 3)

    assert drawn == "▁█▅"


@pytest.mark.parametrize(("values", "drawn"), [([], ""), ([0.0, 0.0], "▁▁"), ([-1.0], "▁")])
def test_a_curve_without_height_stays_low(values, drawn):
    assert curve(values, 8) == drawn


def test_an_evaluation_is_marked_by_how_many_of_its_laps_were_completed():
    drawn = marks([0.0, 0.3, 1.0, None], 8)

    assert drawn == "·◦● "


def test_the_best_evaluation_of_a_shared_character_is_shown():
    drawn = marks([0.0, 1.0, None, 0.5], 2)

    assert drawn == "●◦"

"""Graphs of very long trainings stay small, and say what they leave out."""

import numpy as np

from drcli.analysis.report.graphs import MOST_DOTS, dots_note, many_points


def test_all_of_some_thousand_points_are_drawn():
    series = many_points("episode", np.arange(MOST_DOTS), np.ones(MOST_DOTS), "c1")

    assert len(series.x) == len(series.y) == MOST_DOTS
    assert dots_note(MOST_DOTS, "episode") is None


def test_of_very_many_points_every_nth_is_drawn_and_the_page_says_so():
    count = 3 * MOST_DOTS + 1

    series = many_points("episode", np.arange(count), np.arange(count), "c1", alone=False)

    assert len(series.x) == len(series.y) <= MOST_DOTS
    assert series.x[1] == series.y[1] == 4
    assert "Every 4th episode is a dot" in dots_note(count, "episode")


def test_few_points_are_large_unless_they_surround_a_line():
    assert many_points("lap", [1.0], [2.0], "c1").kind == "marks"
    assert many_points("lap", [1.0], [2.0], "c1", alone=False).color == "dots1"

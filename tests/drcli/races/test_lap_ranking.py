"""Who is first, by any of the rankings."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drcli.races.lap_ranking import (
    RankingRule,
    best_of_each,
    figures_of,
    milliseconds,
    ranked,
    same_racer,
)
from drcli.run.evaluation_report import TrialReport, best_average_s

from .conftest import COMPLETE, lap

laps = st.builds(
    lambda s, status, off: lap(s, status=status, off_track=off),
    st.floats(1, 100),
    st.sampled_from([COMPLETE, COMPLETE, COMPLETE, "Off track", "Time Up"]),
    st.integers(0, 3),
)
drives = st.lists(laps, max_size=5)
races = st.dictionaries(
    st.sampled_from(["b", "a-1", "0", "a", "9b", "c", "-", "10"]), drives, max_size=8
)
rules = st.builds(
    RankingRule,
    st.sampled_from(["best-lap", "best-average", "total-time"]),
    st.integers(1, 3),
    st.integers(3, 6),
)


def figures(driven, average=2):
    return {name: figures_of(each, average) for name, each in driven.items()}


@settings(max_examples=25)
@given(races, rules, st.randoms())
def test_the_order_of_the_submissions_in_the_bucket_does_not_matter(race, rule, random):
    shuffled = list(race.items())
    random.shuffle(shuffled)

    assert ranked(figures(dict(shuffled)), rule) == ranked(figures(race), rule)


@settings(max_examples=25)
@given(races, rules)
def test_ranks_count_up_and_gaps_grow(race, rule):
    found = ranked(figures(race), rule)

    qualified = [place for place in found if place.rank is not None]
    assert found[: len(qualified)] == qualified
    assert [place.rank for place in qualified] == list(range(1, len(qualified) + 1))
    scores = [milliseconds(place.score_s) for place in qualified]
    assert scores == sorted(scores)
    assert all(place.gap_s is not None and place.gap_s >= 0 for place in qualified)
    assert [place.gap_s for place in qualified[:1]] == [0.0] * bool(qualified)


@settings(max_examples=25)
@given(races, drives, rules)
def test_another_submission_does_not_change_who_is_before_whom(race, newcomer, rule):
    name = "zz"

    after = [place.name for place in ranked(figures({**race, name: newcomer}), rule)]

    assert [each for each in after if each != name] == [
        place.name for place in ranked(figures(race), rule)
    ]


@settings(max_examples=25)
@given(races.filter(bool), rules, st.data())
def test_faster_laps_never_cost_a_place(race, rule, data):
    name = data.draw(st.sampled_from(sorted(race)))
    faster = [replace(each, lap_s=each.lap_s * 0.9) for each in race[name]]

    def place(driven):
        return [each.name for each in ranked(figures(driven), rule)].index(name)

    assert place({**race, name: faster}) <= place(race)


@given(drives, st.integers(1, 4))
def test_the_best_average_is_that_of_an_evaluation(driven, length):
    trials = [
        TrialReport(n, each.progress, each.lap_s, each.status, 0, 0, 0)
        for n, each in enumerate(driven, start=1)
    ]

    ours, theirs = figures_of(driven, length).best_average_s, best_average_s(trials, length)

    assert ours == (None if theirs is None else pytest.approx(theirs))


@pytest.mark.parametrize(
    ("ranking", "least", "order"),
    [
        ("best-lap", 1, ["gust", "even", "part"]),
        ("best-average", 2, ["even", "gust"]),
        ("total-time", 3, ["even", "gust"]),
    ],
)
def test_each_ranking_has_its_winner(ranking, least, order):
    race = {
        "gust": [lap(8), lap(15), lap(16)],
        "even": [lap(10), lap(10.5), lap(10)],
        "part": [lap(12), lap(5, status="Off track"), lap(13)],
    }

    found = ranked(figures(race), RankingRule(ranking, least, 3))

    assert [place.name for place in found if place.rank] == order
    assert [place.name for place in found] == [*order, *(set(race) - set(order))]


def test_equal_times_are_decided_by_the_other_times_then_by_who_was_first():
    race = {"2": [lap(10), lap(12)], "1": [lap(10), lap(12)], "3": [lap(10.0004), lap(11)]}

    found = ranked(figures(race), RankingRule("best-lap", 1, 2))

    assert [(place.name, place.rank) for place in found] == [("3", 1), ("1", 2), ("2", 3)]


def test_of_those_not_qualified_the_one_that_came_furthest_is_first():
    race = {
        "1": [lap(1, status="Off track")],
        "2": [lap(1, status="Off track")] * 2,
        "3": [],
    }

    found = ranked(figures(race), RankingRule("best-lap", 1, 2))

    assert [(place.name, place.rank) for place in found] == [("2", None), ("1", None), ("3", None)]


def test_a_racer_has_one_place():
    race = {"1": [lap(10)], "2": [lap(9)], "3": [lap(11)]}
    racers = {"1": "Ann", "2": " ann", "3": "Bob"}

    found = best_of_each(figures(race, 1), racers, RankingRule("best-lap", 1, 1))

    assert [(place.name, place.rank) for place in found] == [("2", 1), ("3", 2)]
    assert same_racer("Ann  B") == same_racer(" ann b ")

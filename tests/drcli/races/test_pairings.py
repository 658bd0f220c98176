"""Who meets whom, and who wins."""

from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drcli.races.pairings import (
    bracket,
    champion,
    pair_name,
    reached,
    round_robin,
    tally,
    winner_of,
)

from .conftest import lap

names = st.lists(st.integers(0, 99).map(str), unique=True, max_size=12)

all_sizes = pytest.mark.parametrize("seeds", [list("KBGACLIEDHJF"[:size]) for size in range(13)])
"""Nothing but their number and order matters in a round robin."""


@all_sizes
def test_everybody_meets_everybody_once(seeds):
    found = round_robin(seeds)

    met = sorted(pair_name(*meeting.pair) for meeting in found)
    assert met == sorted(pair_name(*pair) for pair in combinations(seeds, 2))
    for number in {meeting.round for meeting in found}:
        here = [name for meeting in found if meeting.round == number for name in meeting.pair]
        assert len(here) == len(set(here))


@all_sizes
def test_both_sides_are_shared_fairly(seeds):
    firsts = [meeting.first for meeting in round_robin(seeds)]

    for name in seeds:
        assert abs(2 * firsts.count(name) - (len(seeds) - 1)) <= 1


@settings(max_examples=40)
@given(names.filter(lambda seeds: len(seeds) > 1), st.randoms())
def test_a_bracket_ends_with_one_champion_after_one_race_less_than_there_are_racers(seeds, random):
    winners = {}

    def winner(one, other):
        return winners.get(pair_name(one, other))

    for _ in seeds:
        open_pairs = [
            meeting.pair
            for meeting in bracket(seeds, winner)
            if meeting.pair is not None and winner(*meeting.pair) is None
        ]
        assert (champion(bracket(seeds, winner), winner) is None) == bool(open_pairs)
        if not open_pairs:
            break
        winners[pair_name(*open_pairs[0])] = random.choice(open_pairs[0])

    assert len(winners) == len(seeds) - 1
    best = champion(bracket(seeds, winner), winner)
    assert max(reached(bracket(seeds, winner), winner).items(), key=lambda item: item[1])[0] == best


def test_the_first_two_seeds_meet_in_the_final_only():
    found = bracket(["a", "b", "c", "d"], lambda one, other: min(one, other))

    assert [meeting.pair for meeting in found] == [("a", "d"), ("b", "c"), ("a", "b")]


def test_who_has_no_opponent_goes_on():
    found = bracket(["a", "b", "c"], lambda *_: None)

    assert [(m.first, m.second, m.waits) for m in found] == [
        ("a", None, False),
        ("b", "c", False),
        ("a", None, True),
    ]
    assert found[2].pair is None


def test_a_withdrawn_seed_lets_its_opponent_go_on():
    assert champion(bracket(["a", None], lambda *_: None), lambda *_: None) == "a"


@pytest.mark.parametrize(
    ("one", "other", "winner"),
    [
        ([lap(10), lap(10)], [lap(9), lap(2, status="Off track")], 0),
        ([lap(10), lap(10)], [lap(9), lap(10)], 1),
        ([lap(10)], [lap(10)], None),
        ([lap(10, off_track=1)], [lap(10)], 1),
        ([lap(3, status="Off track")], [], 0),
        ([], [], None),
    ],
)
def test_more_laps_win_then_less_time_then_progress_then_care(one, other, winner):
    assert winner_of([one, other]) == winner


def test_points():
    winners = {pair_name("a", "b"): "a", pair_name("a", "c"): None}

    found = {each.name: each for each in tally(["a", "b", "c"], winners)}

    assert [(found[n].points, found[n].wins, found[n].draws, found[n].losses) for n in "abc"] == [
        (1.5, 1, 1, 0),
        (0.0, 0, 0, 1),
        (0.5, 0, 1, 0),
    ]

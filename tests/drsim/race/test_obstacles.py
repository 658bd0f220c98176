"""Where obstacles stand: gaps in metres, lanes, fixed places, and what does not fit."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drsim.race.race import ObstacleRules, Race
from drsim.race.traffic import (
    FREE_START_M,
    MOST_OBJECTS,
    Traffic,
    check_room,
    drawn_places,
    even_places,
    most_that_fit,
)
from drsim.track.track import INNER, OUTER, Track
from drsim.track.ways import Ways
from drsim.track.worlds import load_track

REINVENT = load_track("reinvent_base")


def ellipse(closed: bool = True) -> Track:
    """A road 1 m wide round an ellipse of 6 m by 4 m, or its larger part."""
    turn = np.linspace(0.0, 2 * np.pi if closed else 5.0, 80)
    lines = [
        np.stack([(3 + aside_m) * np.cos(turn), (2 + aside_m) * np.sin(turn)], axis=1)
        for aside_m in (0.0, -0.5, 0.5)
    ]
    if closed:
        for line in lines:
            line[-1] = line[0]
    return Track("ellipse", lines[0], lines[1], lines[2], closed=closed)


LOOP, ROAD = ellipse(), ellipse(closed=False)


def traffic_of(track: Track, num_cars: int = 1, **rules) -> Traffic:
    return Traffic(Ways([track], num_cars), Race(obstacles=ObstacleRules(**rules)))


def begin(traffic: Traffic, start=0.0, seed=1, cars=(0,), backward=0) -> None:
    count = len(cars)
    traffic.ways.choose(np.array(cars), 0, backward == 1)
    traffic.begin(np.array(cars), np.full(count, start), np.full(count, seed, np.uint64))


def gaps_m(places_m: np.ndarray, track: Track) -> np.ndarray:
    """Distances from each place to the next one, over the finish line too on a loop."""
    places_m = np.sort(places_m)
    if not track.closed:
        return np.diff(places_m)
    return np.diff(np.append(places_m, places_m[:1] + track.length_m))


@st.composite
def crowds(draw):
    """A track, and as many objects as fit or fewer, at a gap of any size."""
    track = draw(st.sampled_from([LOOP, ROAD, REINVENT]))
    gap_m = draw(st.sampled_from([0.0, 1e-300, 0.01, 0.5, 1.0, 2.0, 7.7, 1e300]) | st.floats(0, 20))
    return track, draw(st.integers(0, most_that_fit(track, gap_m))), gap_m


@given(crowds(), st.floats(0.0, 1.0), st.integers(0, 2**64 - 1))
def test_drawn_places_keep_the_gap_for_every_crowd_that_fits(crowd, start, seed) -> None:
    track, count, gap_m = crowd

    places_m = drawn_places(
        track, count, gap_m, start * track.length_m, np.random.default_rng(seed)
    )

    assert places_m.shape == (count,)
    assert np.all((places_m >= 0) & (places_m <= track.length_m))
    if count > 1:
        assert gaps_m(places_m, track).min() >= gap_m - 1e-9


@given(crowds())
def test_even_places_keep_the_gap_for_every_crowd_that_fits(crowd) -> None:
    track, count, gap_m = crowd

    places_m = even_places(track, count, gap_m)

    assert places_m.shape == (count,)
    assert np.all((places_m >= 0) & (places_m <= track.length_m))
    if count > 1:
        assert gaps_m(places_m, track).min() >= gap_m - 1e-9


@given(st.integers(1, 6), st.floats(0.0, 1.0), st.integers(0, 2**32))
def test_drawn_places_leave_the_start_free(count, start, seed) -> None:
    start_m = start * REINVENT.length_m

    places_m = drawn_places(REINVENT, count, 2.0, start_m, np.random.default_rng(seed))

    away_m = np.abs((places_m - start_m + 8) % REINVENT.length_m - 8)
    assert away_m.min() >= FREE_START_M - 1e-9


def test_drawn_places_reach_all_of_the_lap_but_the_start() -> None:
    random = np.random.default_rng(1)

    places_m = np.concatenate([drawn_places(REINVENT, 2, 2.0, 0.0, random) for _ in range(500)])

    hits, _ = np.histogram(places_m, bins=8, range=(1.0, REINVENT.length_m - 1.0))
    assert hits.min() > 80, "125 in each part on average"


@pytest.mark.parametrize("track", [LOOP, ROAD, REINVENT], ids=["loop", "road", "reinvent"])
@pytest.mark.parametrize("gap_m", [0.7, 2.0, 5.0])
def test_one_more_than_fit_is_refused_with_the_number_that_fits(track, gap_m) -> None:
    fit = most_that_fit(track, gap_m)
    traffic_of(track, count=fit, min_gap_m=gap_m)

    with pytest.raises(ValueError, match=rf"too many for {track.name}.*: {fit} would fit"):
        traffic_of(track, count=fit + 1, min_gap_m=gap_m)


def test_a_crowd_beyond_all_measure_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match=f"{MOST_OBJECTS} would fit"):
        traffic_of(REINVENT, count=10**12, min_gap_m=0.0)


@pytest.mark.parametrize("gap_m", [0.0, 3.0, 1e9])
def test_a_single_object_always_fits(gap_m) -> None:
    check_room(REINVENT, 1, gap_m)

    assert 0 <= even_places(REINVENT, 1, gap_m)[0] < REINVENT.length_m


def test_by_default_six_boxes_stand_evenly_on_alternating_lanes() -> None:
    traffic = traffic_of(REINVENT)

    begin(traffic)

    lap_m = REINVENT.length_m
    np.testing.assert_allclose(traffic.distance_m[0], np.linspace(2.0, lap_m - 1, 6), atol=0.2)
    width_m = REINVENT.locate(traffic.xy[0]).track_width_m
    away_m = traffic.objects().from_center_m[0]
    np.testing.assert_allclose(away_m, width_m / 4, rtol=0.05)
    left = traffic.objects().left_of_center[0]
    assert left.tolist() == [True, False] * 3, "inner first, and inside is left here"


def test_default_places_are_the_same_in_every_episode() -> None:
    traffic = traffic_of(REINVENT)
    begin(traffic, seed=1)
    first = traffic.xy.copy()

    for episode in range(20):
        begin(traffic, start=episode * 0.05, seed=episode)

    np.testing.assert_array_equal(traffic.xy, first)


def test_the_gap_does_not_shrink_from_episode_to_episode() -> None:
    traffic = traffic_of(REINVENT, count=8, randomize=True)
    least_m = []

    for episode in range(60):
        begin(traffic, start=episode / 60, seed=episode)
        on_line = REINVENT.locate(traffic.xy[0]).distance_m
        least_m.append(gaps_m(on_line, REINVENT).min())

    # A place on a lane projects a little beside the one on the centre line that it was taken from.
    assert min(least_m) > 2.0 - 0.25


def test_random_places_and_lanes_are_those_of_the_seed() -> None:
    traffic = traffic_of(REINVENT, num_cars=3, randomize=True)

    traffic.begin(np.arange(3), np.zeros(3), np.array([7, 8, 7], np.uint64))

    np.testing.assert_array_equal(traffic.xy[0], traffic.xy[2])
    assert np.abs(traffic.xy[0] - traffic.xy[1]).max() > 0.1


def test_random_lanes_are_both_used() -> None:
    traffic = traffic_of(REINVENT, randomize=True)
    left = []

    for seed in range(30):
        begin(traffic, seed=seed)
        left.append(traffic.objects().left_of_center[0].copy())

    assert 0.35 < np.mean(left) < 0.65


def test_fixed_positions_win_over_number_and_randomisation() -> None:
    traffic = traffic_of(
        REINVENT, count=6, randomize=True, positions=((0.25, -1), (0.5, 1), (0.75, 0))
    )

    begin(traffic)

    share = traffic.distance_m[0] / REINVENT.length_m
    np.testing.assert_allclose(share, [0.25, 0.5, 0.75], atol=0.01)
    left = traffic.objects().left_of_center[0]
    assert left.tolist() == [False, True, True], "-1 is the outer lane, anything else the inner"


def test_fixed_positions_may_stand_closer_than_the_gap() -> None:
    traffic = traffic_of(REINVENT, positions=((0.5, -1), (0.5, 1)), min_gap_m=10.0)

    begin(traffic)

    apart_m = math.dist(*traffic.xy[0])
    assert apart_m == pytest.approx(REINVENT.locate(traffic.xy[0]).track_width_m[0] / 2, rel=0.05)


@pytest.mark.parametrize("fraction", [0.0, 1.0])
def test_a_fixed_position_at_either_end_of_the_lap_is_the_start_line(fraction) -> None:
    traffic = traffic_of(REINVENT, positions=((fraction, 1),))

    begin(traffic)

    start = REINVENT.pose_at(np.zeros(1), "inner")[0]
    np.testing.assert_allclose(traffic.xy[0, 0], start[:2], atol=1e-6)


def test_boxes_look_along_their_lane() -> None:
    traffic = traffic_of(REINVENT, count=8, min_gap_m=1.0)

    begin(traffic)

    for lane, first in (("inner", 0), ("outer", 1)):
        behind = REINVENT.pose_at(traffic.distance_m[0, first::2] - 0.05, lane)[:, :2]
        ahead = REINVENT.pose_at(traffic.distance_m[0, first::2] + 0.05, lane)[:, :2]
        along = np.arctan2(*(ahead - behind).T[::-1])
        off_rad = (traffic.yaw_rad[0, first::2] - along + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(off_rad).max() < 0.2


def test_a_car_that_drives_the_lap_backwards_counts_places_in_its_own_direction() -> None:
    traffic = traffic_of(REINVENT, num_cars=2, positions=((0.25, 1),))

    traffic.ways.choose(np.arange(2), 0, np.array([False, True]))
    traffic.begin(np.arange(2), np.zeros(2), np.zeros(2, np.uint64))

    share = traffic.distance_m[:, 0] / REINVENT.length_m
    np.testing.assert_allclose(share, [0.25, 0.25], atol=0.01)
    there = REINVENT.locate(traffic.xy[:, 0]).distance_m / REINVENT.length_m
    np.testing.assert_allclose(there, [0.25, 0.75], atol=0.01)
    assert traffic.objects().left_of_center[:, 0].tolist() == [True, False], "inner both times"


@pytest.mark.parametrize(("lane", "expected"), [(-1, OUTER), (1, INNER), (0, INNER), (2, INNER)])
def test_lanes_are_named_as_in_the_reference(lane, expected) -> None:
    traffic = traffic_of(REINVENT, positions=((0.5, lane),))

    begin(traffic, start=0.5)

    away = INNER + OUTER - expected
    assert traffic.start_lane(np.array([0])).tolist() == [away]


@pytest.mark.parametrize(
    "wrong",
    [
        {"count": -1},
        {"min_gap_m": math.nan},
        {"min_gap_m": math.inf},
        {"min_gap_m": -0.1},
        {"positions": ((1.2, 1),)},
        {"positions": ((math.nan, 1),)},
        {"reset_behind_m": -1.0},
        {"mercy": -3},
    ],
)
def test_numbers_that_make_no_race_are_refused_by_name(wrong) -> None:
    (name,) = wrong

    with pytest.raises(ValueError, match=name):
        ObstacleRules(**wrong)


def test_no_obstacles_at_all_is_a_race_too() -> None:
    traffic = traffic_of(REINVENT, count=0)

    begin(traffic)

    assert traffic.xy.shape == (1, 0, 2)
    assert traffic.start_lane(np.array([0])).tolist() == [0]

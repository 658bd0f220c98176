"""What cars meet: whose fault a contact is, where they start, where they go on afterwards."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drsim.race.race import BotRules, ObstacleRules, Race
from drsim.race.traffic import NEAR_M, OPPONENT_GAP_M, Traffic
from drsim.track.track import CENTER, INNER, OUTER, Track
from drsim.track.ways import Ways
from drsim.track.worlds import load_track

NOSE_M = 0.14
"""The point that is located on the track lies this far ahead of a car's origin."""


def ring(rows: int = 120) -> Track:
    """A road 0.8 m wide round a circle of 3 m, driven counter-clockwise; about 18.8 m long."""
    turn = np.linspace(0.0, 2 * np.pi, rows)
    lines = [r * np.stack([np.cos(turn), np.sin(turn)], axis=1) for r in (3.0, 2.6, 3.4)]
    for line in lines:
        line[-1] = line[0]
    return Track("ring", lines[0], lines[1], lines[2], closed=True)


RING = ring()
LENGTH_M = RING.length_m


def traffic_with(num_cars: int = 1, *, track: Track = RING, begun: bool = True, **race) -> Traffic:
    traffic = Traffic(Ways([track], num_cars), Race(**race))
    if begun:
        begin(traffic, np.arange(num_cars))
    return traffic


def begin(traffic: Traffic, cars, start=0.0, backward=0, seed=1) -> None:
    traffic.ways.choose(np.asarray(cars), 0, backward == 1)
    traffic.begin(np.asarray(cars), np.full(len(cars), start), np.full(len(cars), seed, np.uint64))


def boxes(*positions: tuple[float, float], **rules) -> ObstacleRules:
    """Boxes at distances in metres, on lanes as in the settings."""
    return ObstacleRules(positions=tuple((m / LENGTH_M, lane) for m, lane in positions), **rules)


def put(at_m: float, aside_m: float = 0.0, backward: int = 0, racers: int = 1):
    """The arguments of `contacts` for cars whose origins are at a place: shapes of `racers` rows.

    Args:
        at_m: Along the centre line, in the driving direction.
        aside_m: Towards the inside of the ring.
        backward: Whether the car drives clockwise.
        racers: How many cars stand there.
    """
    turn = at_m / LENGTH_M * 2 * np.pi * (1 - 2 * backward)
    away = np.array([np.cos(turn), np.sin(turn)])
    xy = np.tile((3.0 - aside_m) * away, (racers, 1))
    yaw_rad = np.full(racers, turn + (np.pi / 2 if not backward else -np.pi / 2))
    return xy, yaw_rad, np.full(racers, (at_m + NOSE_M) % LENGTH_M)


def touch(traffic: Traffic, at_m: float, aside_m: float = 0.0, active: bool = True, **where):
    return traffic.contacts(np.array([active]), *put(at_m, aside_m, **where))


@pytest.mark.parametrize("at_m", [4.7, 5.0, 5.3], ids=["behind", "inside", "ahead"])
def test_touching_a_box_is_a_crash_from_all_sides(at_m) -> None:
    traffic = traffic_with(obstacles=boxes((9.0, 1), (5.0, 1)))

    contacts = touch(traffic, at_m, aside_m=0.2)

    assert contacts.crashed.tolist() == [True]
    assert contacts.other.tolist() == [1]
    assert contacts.other_stands.tolist() == [True]


def test_passing_a_box_on_the_other_lane_is_none() -> None:
    traffic = traffic_with(obstacles=boxes((5.0, 1)))

    contacts = touch(traffic, 5.0, aside_m=-0.2)

    assert contacts.crashed.tolist() == [False]
    assert contacts.other.tolist() == [-1]


def test_a_parked_car_is_an_obstacle_with_the_footprint_of_a_car() -> None:
    traffic = traffic_with(obstacles=boxes((5.0, 1), kind="bot_car"))

    ahead, near, beside = (
        touch(traffic, at_m, aside_m=aside_m)
        for at_m, aside_m in ((5.25, 0.2), (4.62, 0.2), (5.0, -0.02))
    )

    assert ahead.crashed.tolist() == [True], "whoever is ahead, it stands still"
    assert near.crashed.tolist() == [False], "a box would have been touched"
    assert beside.crashed.tolist() == [False]


def test_a_car_that_is_not_driven_touches_nothing() -> None:
    traffic = traffic_with(obstacles=boxes((5.0, 1)))

    contacts = touch(traffic, 5.0, aside_m=0.2, active=False)

    assert contacts.crashed.tolist() == [False]


def bot_at(distance_m: float) -> Traffic:
    """A ring with one bot on the inner lane that has driven to about a place."""
    traffic = traffic_with(bots=BotRules(count=1, min_gap_m=1.0, speed_mps=1.5))
    while traffic.distance_m[0, 0] < distance_m - 0.05:
        traffic.advance(np.array([True]))
    return traffic


def test_driving_into_a_bot_is_a_crash_and_the_bot_goes_on() -> None:
    traffic = bot_at(5.0)
    bot_m = float(traffic.distance_m[0, 0])

    contacts = touch(traffic, bot_m - 0.25, aside_m=0.2)
    traffic.advance(np.array([True]))

    assert contacts.crashed.tolist() == [True]
    assert contacts.other_stands.tolist() == [False]
    assert traffic.distance_m[0, 0] > bot_m


def test_being_hit_by_a_bot_is_none_and_makes_all_bots_wait() -> None:
    traffic = traffic_with(bots=BotRules(count=2, penalty_s=2.0))
    bot_m = float(traffic.distance_m[0, 0])

    contacts = touch(traffic, bot_m + 0.25, aside_m=0.2)
    before = traffic.xy.copy()
    for _ in range(30):
        traffic.advance(np.array([True]))
    waited = traffic.xy.copy()
    traffic.advance(np.array([True]))

    assert contacts.crashed.tolist() == [False]
    np.testing.assert_array_equal(waited, before)
    assert np.all(np.hypot(*(traffic.xy - waited)[0].T) > 0.005)


@pytest.mark.parametrize("backward", [0, 1])
@pytest.mark.parametrize(("apart_m", "crash"), [(0.25, True), (-0.25, False)])
def test_ahead_and_behind_are_told_apart_across_the_finish_line(apart_m, crash, backward) -> None:
    traffic = traffic_with(begun=False, bots=BotRules(count=1, min_gap_m=0.0, speed_mps=0.0))
    begin(traffic, [0], backward=backward)
    (bot_m,) = traffic.distance_m[0].tolist()
    assert min(bot_m, LENGTH_M - bot_m) < 0.05, "the bot stands on the line"

    contacts = touch(traffic, -apart_m, aside_m=0.2, backward=backward)

    assert contacts.crashed.tolist() == [crash]


@given(at_m=st.floats(0.0, LENGTH_M), apart_m=st.floats(0.01, 0.3), active=st.booleans())
def test_of_two_racers_that_touch_the_one_behind_crashes(at_m, apart_m, active) -> None:
    traffic = traffic_with(2, racers=2)
    first, second = put(at_m), put(at_m - apart_m)
    xy, yaw_rad, along_m = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    traffic.follow(xy, yaw_rad)

    contacts = traffic.contacts(np.array([active, True]), xy, yaw_rad, along_m)

    assert contacts.crashed.tolist() == [False, active], "nobody touches a car that waits"
    assert contacts.other.tolist() == [-1, 0 if active else -1]
    assert not contacts.other_stands.any()


def test_racers_meet_only_within_their_pair() -> None:
    traffic = traffic_with(4, racers=2)
    places = [put(at_m) for at_m in (5.0, 9.0, 5.2, 9.2)]
    xy, yaw_rad, along_m = (np.concatenate(part) for part in zip(*places, strict=True))
    traffic.follow(xy, yaw_rad)

    contacts = traffic.contacts(np.ones(4, np.bool_), xy, yaw_rad, along_m)

    np.testing.assert_array_equal(traffic.xy[:, 0], xy[[1, 0, 3, 2]])
    np.testing.assert_allclose(traffic.distance_m[:, 0], [9.0, 5.0, 9.2, 5.2], atol=0.02)
    assert not contacts.crashed.any()


@pytest.mark.parametrize(
    ("box_m", "lane", "start"),
    [
        (5.0, 1, CENTER),
        (0.8, 1, OUTER),
        (0.8, -1, INNER),
        (LENGTH_M - 0.8, 1, OUTER),
        (LENGTH_M - 0.8, -1, INNER),
    ],
)
def test_a_car_starts_on_the_lane_away_from_a_near_box(box_m, lane, start) -> None:
    traffic = traffic_with(obstacles=boxes((box_m, lane)))

    assert traffic.start_lane(np.array([0])).tolist() == [start]


def test_between_two_near_boxes_a_car_starts_on_the_lane_with_more_room() -> None:
    traffic = traffic_with(obstacles=boxes((0.5, 1), (LENGTH_M - 0.9, -1)))

    assert traffic.start_lane(np.array([0])).tolist() == [OUTER]


@pytest.mark.parametrize("backward", [0, 1])
@given(start=st.floats(0.0, 1.0), count=st.integers(1, 15))
def test_no_start_touches_evenly_placed_boxes(backward, start, count) -> None:
    traffic = traffic_with(begun=False, obstacles=ObstacleRules(count=count, min_gap_m=0.9))
    begin(traffic, [0], start=start, backward=backward)
    (lane,) = traffic.start_lane(np.array([0])).tolist()
    aside_m = {CENTER: 0.0, INNER: 0.2, OUTER: -0.2}[lane]

    contacts = touch(traffic, start * LENGTH_M, aside_m=aside_m, backward=backward)

    assert contacts.crashed.tolist() == [False]


@pytest.mark.parametrize("backward", [0, 1])
@given(start=st.floats(0.0, 1.0), seed=st.integers(0, 2**64 - 1))
def test_no_start_touches_randomly_placed_boxes(backward, start, seed) -> None:
    traffic = traffic_with(begun=False, obstacles=ObstacleRules(randomize=True))
    begin(traffic, [0], start=start, backward=backward, seed=seed)

    contacts = touch(traffic, start * LENGTH_M, backward=backward)

    assert traffic.start_lane(np.array([0])).tolist() == [CENTER] or (
        np.abs(traffic.distance_m[0] - start * LENGTH_M).min() < NEAR_M
    )
    assert contacts.crashed.tolist() == [False]


def test_racers_start_on_different_lanes_and_the_second_one_behind() -> None:
    traffic = traffic_with(4, racers=2)
    everybody = np.arange(4)

    lanes, gaps_m = traffic.start_lane(everybody), traffic.start_gap_m(everybody)

    assert lanes.tolist() == [OUTER, INNER, OUTER, INNER]
    assert gaps_m.tolist() == [0.0, OPPONENT_GAP_M, 0.0, OPPONENT_GAP_M]


def test_a_new_episode_of_one_car_leaves_the_others_alone() -> None:
    traffic = traffic_with(3, obstacles=ObstacleRules(randomize=True), bots=BotRules())
    before = traffic.xy.copy()

    begin(traffic, [1], start=0.4, seed=77)

    np.testing.assert_array_equal(traffic.xy[[0, 2]], before[[0, 2]])
    assert np.abs(traffic.xy[1] - before[1]).max() > 0.1


def test_objects_come_in_the_order_opponent_obstacles_bots() -> None:
    traffic = traffic_with(
        2,
        racers=2,
        obstacles=ObstacleRules(count=2, kind="amazon_box_obstacle"),
        bots=BotRules(count=1),
    )

    names = [shape.name for shape in traffic.shapes]

    assert names == ["race_car", "amazon_box_obstacle", "amazon_box_obstacle", "bot_car"]
    assert traffic.xy.shape == (2, 4, 2)


def clear(traffic: Traffic, at_m: float, lane: int = OUTER) -> tuple[float, int]:
    """Where a car goes on, in metres, that would be put back somewhere."""
    fraction, lanes = traffic.clear_of(np.array([0]), np.array([at_m / LENGTH_M]), np.array([lane]))
    return float(fraction[0]) * LENGTH_M, int(lanes[0])


@pytest.mark.parametrize(("lane", "opposite"), [(1, OUTER), (-1, INNER)])
@pytest.mark.parametrize("at_m", [4.2, 5.0, 5.9])
def test_near_a_box_a_car_goes_on_a_metre_behind_it_on_the_other_lane(at_m, lane, opposite) -> None:
    traffic = traffic_with(obstacles=boxes((5.0, lane)))

    place_m, on = clear(traffic, at_m)

    assert place_m == pytest.approx(4.0, abs=0.02)
    assert on == opposite


def test_far_from_boxes_a_car_goes_on_where_it_was() -> None:
    traffic = traffic_with(obstacles=boxes((5.0, 1)))

    assert clear(traffic, 6.2, INNER) == (pytest.approx(6.2), INNER)


def test_a_box_behind_the_finish_line_puts_a_car_back_across_it() -> None:
    traffic = traffic_with(obstacles=boxes((0.4, 1), reset_behind_m=0.8))

    place_m, on = clear(traffic, LENGTH_M - 0.2)

    assert place_m == pytest.approx(LENGTH_M - 0.4, abs=0.02)
    assert on == OUTER


def test_where_rules_have_mercy_every_third_time_is_ahead_of_the_box() -> None:
    traffic = traffic_with(obstacles=boxes((5.0, 1), (9.0, 1), mercy=3))

    places_m = [clear(traffic, 5.0)[0] for _ in range(4)]
    elsewhere_m, _ = clear(traffic, 9.0)
    begin(traffic, [0])
    next_episode_m, _ = clear(traffic, 5.0)

    assert places_m == pytest.approx([4.0, 4.0, 6.0, 4.0], abs=0.02)
    assert elsewhere_m == pytest.approx(8.0, abs=0.02)
    assert next_episode_m == pytest.approx(4.0, abs=0.02)


def test_no_car_is_put_back_into_the_box_before() -> None:
    traffic = traffic_with(obstacles=boxes((4.0, -1), (5.0, 1)))

    place_m, on = clear(traffic, 4.9)

    assert place_m == pytest.approx(4.0, abs=0.02)
    assert on == INNER
    assert touch(traffic, place_m, aside_m=0.2).crashed.tolist() == [False]


def test_bots_put_nobody_elsewhere() -> None:
    traffic = traffic_with(bots=BotRules())

    at_m = float(traffic.distance_m[0, 0])

    assert clear(traffic, at_m, INNER) == (pytest.approx(at_m), INNER)


def test_places_are_those_of_the_track_itself() -> None:
    reinvent = load_track("reinvent_base")
    traffic = traffic_with(
        2, track=reinvent, begun=False, obstacles=ObstacleRules(), bots=BotRules(lane_change=True)
    )
    traffic.ways.choose(np.arange(2), 0, np.array([False, True]))
    traffic.begin(np.arange(2), np.array([0.1, 0.6]), np.array([1, 2], np.uint64))
    for _ in range(100):
        traffic.advance(np.ones(2, np.bool_))

    objects = traffic.objects()

    for car, track in enumerate((reinvent, reinvent.reversed())):
        where = track.locate(objects.xy[car])
        np.testing.assert_array_equal(objects.distance_m[car], where.distance_m)
        np.testing.assert_array_equal(objects.from_center_m[car], where.from_center_m)
        np.testing.assert_array_equal(objects.left_of_center[car], where.left_of_center)


def test_bots_drive_the_way_their_car_does() -> None:
    traffic = traffic_with(2, begun=False, bots=BotRules(count=1))
    traffic.ways.choose(np.arange(2), 0, np.array([False, True]))
    traffic.begin(np.arange(2), np.zeros(2), np.zeros(2, np.uint64))
    turns = []

    for _ in range(10):
        turns.append(np.arctan2(traffic.xy[:, 0, 1], traffic.xy[:, 0, 0]))
        traffic.advance(np.ones(2, np.bool_))

    assert all(a[0] < b[0] and a[1] > b[1] for a, b in pairwise(turns))
    heading_rad = traffic.yaw_rad[:, 0] - turns[-1]
    off_rad = (heading_rad - [np.pi / 2, -np.pi / 2] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off_rad).max() < 0.05


@pytest.mark.parametrize(
    "race",
    [
        {"obstacles": ObstacleRules(count=0)},
        {"bots": BotRules(count=0)},
        {"obstacles": ObstacleRules(count=0), "bots": BotRules(count=0), "racers": 2},
    ],
)
def test_races_without_objects_run(race) -> None:
    traffic = traffic_with(2, **race)
    args = put(3.0, racers=2)

    traffic.advance(np.ones(2, np.bool_))
    traffic.follow(*args[:2])
    contacts = traffic.contacts(np.ones(2, np.bool_), *args)

    assert contacts.crashed.shape == (2,)
    assert clear(traffic, 3.0) == (pytest.approx(3.0), OUTER)


@pytest.mark.parametrize("racers", [0, 3, -1])
def test_other_numbers_of_racers_are_refused(racers) -> None:
    with pytest.raises(ValueError, match=f"racers is {racers}"):
        Race(racers=racers)

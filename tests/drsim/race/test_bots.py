"""How bots drive: smooth lanes, lane changes, waits, and never off the road."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drsim.car.car import CONTROL_HZ
from drsim.race.bots import Bots, LanePaths, LanePlaces
from drsim.race.race import BotRules, Race
from drsim.race.traffic import Traffic
from drsim.track.track import Track
from drsim.track.ways import Ways
from drsim.track.worlds import load_track

ROUTES = Path(__file__).resolve().parents[4] / "shared" / "tracks"
REINVENT = load_track("reinvent_base")
EVERYBODY = np.ones(1, np.bool_)
STEP_S = 1.0 / CONTROL_HZ


def ring(rows: int = 60, skew_rad: float = 0.0, end: float = 1.0) -> Track:
    """A road 0.8 m wide round a circle of 3 m, or a part of it.

    Args:
        rows: Vertices of each line.
        skew_rad: How far the vertices of both borders lag behind those of the centre line.
        end: How much of the circle there is.
    """
    turn = np.linspace(0.0, 2 * np.pi * end, rows)
    lines = [
        radius_m * np.stack([np.cos(turn - lag), np.sin(turn - lag)], axis=1)
        for radius_m, lag in ((3.0, 0.0), (2.6, skew_rad), (3.4, skew_rad))
    ]
    if end == 1.0:
        for line in lines:
            line[-1] = line[0]
    return Track("ring", lines[0], lines[1], lines[2], closed=end == 1.0)


def both(track: Track) -> tuple[Track, Track]:
    return track, track.reversed()


def on_lanes(track: Track, at_m: np.ndarray, share: float, backward: int = 0):
    """Points and directions of a lane, shapes (m, 2) and (m,)."""
    shape = (1, len(at_m))
    places = LanePlaces(at_m[None], np.full(shape, share), np.zeros(shape))
    ways = Ways([track], 1)
    ways.choose(np.zeros(1, np.int64), 0, backward == 1)
    xy, yaw_rad = LanePaths(ways.tracks).poses(ways, places)
    return xy[0], yaw_rad[0]


def drive(track: Track, steps: int, *, seed: int = 1, start=0.0, backward: int = 0, **rules):
    """Places, directions and distances of the bots of one car; shapes (steps, k, ...)."""
    traffic = Traffic(Ways([track], 1), Race(bots=BotRules(**rules)))
    car = np.zeros(1, np.int64)
    traffic.ways.choose(car, 0, backward == 1)
    traffic.begin(car, np.array([start]), np.array([seed], np.uint64))
    xy, yaw_rad, distance_m = [], [], []
    for _ in range(steps):
        xy.append(traffic.xy[0].copy())
        yaw_rad.append(traffic.yaw_rad[0].copy())
        distance_m.append(traffic.distance_m[0].copy())
        traffic.advance(EVERYBODY)
    return np.array(xy), np.array(yaw_rad), np.array(distance_m)


@pytest.mark.parametrize(("share", "radius_m"), [(0.0, 2.8), (0.5, 3.0), (1.0, 3.2)])
def test_lanes_of_a_ring_are_circles(share, radius_m) -> None:
    track = ring()
    at_m = np.linspace(0.0, track.length_m, 500, endpoint=False)

    xy, yaw_rad = on_lanes(track, at_m, share)

    np.testing.assert_allclose(np.hypot(*xy.T), radius_m, atol=0.002)
    along_rad = np.arctan2(xy[:, 1], xy[:, 0]) + np.pi / 2
    assert np.abs((yaw_rad - along_rad + np.pi) % (2 * np.pi) - np.pi).max() < 0.03


def test_lanes_pass_through_their_vertices() -> None:
    vertices = (REINVENT.center + REINVENT.outer)[:-1] / 2
    at_m = REINVENT.locate(vertices).distance_m

    xy, _ = on_lanes(REINVENT, at_m, 1.0)

    assert np.hypot(*(xy - vertices).T).max() < 0.002


@pytest.mark.parametrize("backward", [0, 1])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("skew_rad", [-0.2, 0.2])
def test_vertices_on_the_other_side_of_the_finish_line_bend_no_lane(
    skew_rad, share, backward
) -> None:
    track = ring(skew_rad=skew_rad)
    at_m = np.linspace(0.0, 2 * track.length_m, 3000)

    xy, _ = on_lanes(track, at_m, share, backward)

    assert track.on_road(xy).all()
    speed = np.hypot(*np.diff(xy, axis=0).T) / np.diff(at_m)
    assert 0.9 < speed.min() < speed.max() < 1.1


@pytest.mark.parametrize("backward", [0, 1])
@pytest.mark.parametrize(
    "world",
    ["reinvent_base", "Bowtie_track", "Mexico_track", "Tokyo_Training_track", "hamption_pro"],
)
def test_lanes_of_known_tracks_have_no_jump_and_no_turn_on_the_spot(world, backward) -> None:
    file = ROUTES / f"{world}.npy"
    if not file.is_file():
        pytest.skip(f"there is no folder of reference routes with {world}.npy")
    track = load_track(str(file))
    at_m = np.arange(0.0, track.length_m + 0.1, 0.01)
    lanes = [on_lanes(track, at_m, share, backward) for share in (0.0, 1.0)]

    for xy, yaw_rad in lanes:
        speed = np.hypot(*np.diff(xy, axis=0).T) / 0.01
        assert 0.1 < speed.min() < speed.max() < 2.0
        turn_rad = (np.diff(yaw_rad) + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(turn_rad).max() < 0.1
        # One border of one of these tracks crosses itself for a few centimetres.
        assert both(track)[backward].on_road(xy).mean() > 0.97


@st.composite
def bot_rules(draw):
    low_s = draw(st.floats(0.0, 6.0))
    return {
        "count": draw(st.integers(0, 4)),
        "speed_mps": draw(st.sampled_from([0.0, 1e-9, 0.2, 1.0, 4.0]) | st.floats(0.0, 4.0)),
        "min_gap_m": draw(st.sampled_from([0.0, 1.0, 3.0])),
        "randomize": draw(st.booleans()),
        "lane_change": draw(st.booleans()),
        "lane_change_time_s": (low_s, low_s + draw(st.floats(0.0, 3.0))),
        "lane_change_distance_m": draw(st.floats(0.5, 5.0)),
    }


@settings(max_examples=40)
@given(
    rules=bot_rules(),
    track=st.sampled_from([REINVENT, ring()]),
    backward=st.integers(0, 1),
    start=st.floats(0.0, 1.0),
    seed=st.integers(0, 2**64 - 1),
)
def test_bots_stay_on_the_road_and_never_jump(rules, track, backward, start, seed) -> None:
    xy, yaw_rad, _ = drive(track, 150, seed=seed, start=start, backward=backward, **rules)

    assert np.isfinite(yaw_rad).all()
    assert track.on_road(xy).all()
    step_m = np.hypot(*np.moveaxis(np.diff(xy, axis=0), -1, 0))
    # The lanes are half a track apart, and a change is fastest in its middle: 1.5 times the mean.
    sideways = 0.5 * rules["lane_change"] / rules["lane_change_distance_m"] * 1.5
    assert np.all(step_m <= rules["speed_mps"] * STEP_S * (1.6 + sideways) + 1e-9)
    moving = step_m > 0.01
    chord_rad = np.arctan2(*np.moveaxis(np.diff(xy, axis=0), -1, 0)[::-1])
    off_rad = (chord_rad - yaw_rad[:-1] + np.pi) % (2 * np.pi) - np.pi
    assert np.all(np.abs(off_rad[moving]) < 0.8), "they look where they go"


def test_bots_keep_their_speed_along_the_centre_line() -> None:
    _, _, distance_m = drive(ring(), 300, speed_mps=0.5)

    gone_m = np.unwrap(distance_m, axis=0, period=ring().length_m) - distance_m[0]
    expected_m = 0.5 * STEP_S * np.arange(300)[:, None]
    # Projected on the polygon that the centre line is, motion is not even from step to step.
    np.testing.assert_allclose(gone_m, np.broadcast_to(expected_m, gone_m.shape), atol=0.05)


def test_a_bot_on_the_outer_lane_is_faster_than_one_on_the_inner() -> None:
    xy, _, _ = drive(ring(), 100, count=2, speed_mps=0.6)

    inner_m, outer_m = np.hypot(*np.moveaxis(np.diff(xy, axis=0), -1, 0)).sum(axis=0)
    assert outer_m / inner_m == pytest.approx(3.2 / 2.8, rel=0.01)


def test_bots_keep_to_their_lanes_unless_told_otherwise() -> None:
    track = ring()

    xy, _, _ = drive(track, 300, count=4, speed_mps=1.0)

    radius_m = np.hypot(xy[..., 0], xy[..., 1])
    np.testing.assert_allclose(radius_m[:, ::2], 2.8, atol=0.003)
    np.testing.assert_allclose(radius_m[:, 1::2], 3.2, atol=0.003)


def test_a_lane_change_takes_its_distance_after_its_time() -> None:
    xy, _, _ = drive(
        ring(),
        300,
        count=1,
        speed_mps=0.5,
        lane_change=True,
        lane_change_time_s=(4.0, 4.0),
        lane_change_distance_m=1.0,
    )

    share = (np.hypot(xy[:, 0, 0], xy[:, 0, 1]) - 2.8) / 0.4
    away = np.flatnonzero(share > 0.005)
    there = np.flatnonzero(share > 0.995)
    assert away[0] * STEP_S == pytest.approx(4.0, abs=3 * STEP_S)
    assert (there[0] - away[0]) * STEP_S == pytest.approx(2.0, abs=4 * STEP_S)
    back = np.flatnonzero(share[there[0] :] < 0.9)[0] + there[0]
    assert back * STEP_S > 4.0 + 2.0 + 4.0, "then it waits again before it changes back"


def test_lane_changes_are_drawn_between_the_two_times() -> None:
    begun_s = []

    for seed in range(40):
        rules = {"count": 1, "lane_change": True, "lane_change_time_s": (1.0, 3.0)}
        xy, _, _ = drive(ring(), 60, seed=seed, speed_mps=1.0, **rules)
        radius_m = np.hypot(xy[:, 0, 0], xy[:, 0, 1])
        begun_s.append(np.flatnonzero(radius_m > 2.81)[0] * STEP_S)

    assert 1.0 <= min(begun_s) < 1.4
    assert 2.6 < max(begun_s) <= 3.3


def test_bots_that_stand_still_change_no_lane() -> None:
    xy, _, _ = drive(ring(), 200, speed_mps=0.0, lane_change=True, lane_change_time_s=(0.0, 0.1))

    np.testing.assert_array_equal(xy, np.broadcast_to(xy[0], xy.shape))


def test_the_same_seed_gives_the_same_drive_whatever_came_before() -> None:
    race = Race(bots=BotRules(randomize=True, lane_change=True, lane_change_time_s=(0.5, 1.0)))
    traffic = Traffic(Ways([REINVENT], 2), race)
    cars, seeds = np.arange(2), np.array([5, 6], np.uint64)
    traffic.begin(cars, np.array([0.1, 0.2]), seeds)

    def drive_first() -> np.ndarray:
        traffic.begin(cars[:1], np.array([0.3]), np.array([9], np.uint64))
        places = []
        for _ in range(120):
            places.append(traffic.xy[0].copy())
            traffic.advance(np.ones(2, np.bool_))
        return np.array(places)

    first = drive_first()
    again = drive_first()

    np.testing.assert_array_equal(first, again)


def test_a_halt_stops_all_bots_of_a_car_for_the_penalty_and_no_others() -> None:
    bots = Bots(2, BotRules(count=2, penalty_s=2.0))
    for car in range(2):
        bots.begin(car, np.array([1.0, 4.0]), np.array([0, 1]), np.random.default_rng(car))
    everybody = np.ones(2, np.bool_)

    bots.halt(np.array([True, False]))
    moved = []
    for _ in range(32):
        before_m = bots.places.distance_m.copy()
        bots.advance(everybody)
        moved.append((bots.places.distance_m > before_m).all(axis=1))

    first, second = np.array(moved).T
    assert first.tolist() == [False] * 30 + [True] * 2, "2 s are 30 steps"
    assert second.all()


def test_a_second_halt_during_the_first_changes_nothing() -> None:
    bots = Bots(1, BotRules(count=1, penalty_s=1.0))
    bots.begin(0, np.array([1.0]), np.array([0]), np.random.default_rng(0))

    for _ in range(10):
        bots.halt(EVERYBODY)
        bots.advance(EVERYBODY)
    still_m = bots.places.distance_m.copy()
    for _ in range(6):
        bots.advance(EVERYBODY)

    assert still_m[0, 0] == 1.0
    assert bots.places.distance_m[0, 0] == pytest.approx(1.0 + 0.2 / 15)


def test_a_halt_puts_lane_changes_off_by_as_much() -> None:
    rules = BotRules(
        count=1, speed_mps=0.5, lane_change=True, lane_change_time_s=(2.0, 2.0), penalty_s=1.0
    )
    shares = []
    for halts in (False, True):
        bots = Bots(1, rules)
        bots.begin(0, np.array([1.0]), np.array([0]), np.random.default_rng(0))
        bots.halt(np.array([halts]))
        shares.append([])
        for _ in range(80):
            bots.advance(EVERYBODY)
            shares[-1].append(bots.places.share[0, 0])

    undisturbed, halted = shares
    assert halted[15:] == undisturbed[:-15]
    assert max(undisturbed) == 1.0


def test_bots_of_a_car_that_waits_for_its_start_stand_still() -> None:
    traffic = Traffic(Ways([REINVENT], 2), Race(bots=BotRules()))
    everybody = np.arange(2)
    traffic.begin(everybody, np.zeros(2), np.zeros(2, np.uint64))
    before = traffic.xy.copy()

    traffic.advance(np.array([True, False]))

    assert np.all(np.hypot(*(traffic.xy[0] - before[0]).T) > 0.005)
    np.testing.assert_array_equal(traffic.xy[1], before[1])


@pytest.mark.parametrize("backward", [0, 1])
def test_on_an_open_track_bots_begin_again_at_its_start(backward) -> None:
    track = ring(end=0.4)

    xy, yaw_rad, distance_m = drive(track, 200, backward=backward, count=1, speed_mps=2.0)

    assert distance_m[:, 0].max() > track.length_m - 0.2
    (wraps,) = np.nonzero(np.diff(distance_m[:, 0]) < 0)
    assert len(wraps) == 3
    assert distance_m[wraps + 1, 0].max() < 0.2
    along_rad = np.arctan2(xy[:, 0, 1], xy[:, 0, 0]) + (np.pi / 2 if backward == 0 else -np.pi / 2)
    off_rad = (yaw_rad[:, 0] - along_rad + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off_rad).max() < 0.05, "at either end too they look along the track"
    assert np.hypot(*xy[:, 0].T) == pytest.approx(2.8, abs=0.005)


@pytest.mark.parametrize(
    "wrong",
    [
        {"count": -1},
        {"speed_mps": -0.2},
        {"speed_mps": 1e300},
        {"speed_mps": np.nan},
        {"min_gap_m": -1.0},
        {"penalty_s": np.inf},
        {"lane_change_distance_m": -1.0},
        {"lane_change_time_s": (5.0, 3.0)},
        {"lane_change_time_s": (-1.0, 3.0)},
        {"lane_change_time_s": (1.0, np.inf)},
    ],
)
def test_numbers_that_make_no_race_are_refused_by_name(wrong) -> None:
    (name,) = wrong

    with pytest.raises(ValueError, match=name):
        BotRules(**wrong)


def test_more_bots_than_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"20 objects .* too many for reinvent_base.*: 8 would"):
        Traffic(Ways([REINVENT], 1), Race(bots=BotRules(count=20)))


@pytest.mark.parametrize(
    "extreme",
    [
        {"count": 0},
        {"speed_mps": 100.0, "lane_change": True, "lane_change_time_s": (0.0, 0.0)},
        {"lane_change_distance_m": 0.0, "lane_change": True, "lane_change_time_s": (0.0, 0.0)},
        {"lane_change_distance_m": 1e300, "lane_change": True},
        {"penalty_s": 1e300},
        {"min_gap_m": 0.0, "count": 100},
        {"min_gap_m": 1e300, "count": 1, "randomize": True},
    ],
)
def test_extreme_rules_hang_nothing_and_give_numbers(extreme) -> None:
    xy, yaw_rad, distance_m = drive(REINVENT, 60, **extreme)

    assert np.isfinite(xy).all()
    assert np.isfinite(yaw_rad).all()
    assert np.isfinite(distance_m).all()

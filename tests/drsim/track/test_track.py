"""Where points lie along and across a track: worked by hand, and with shapely as the judge."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from drsim.track.track import Track
from drsim.track.worlds import load_track

ROUTES = Path(__file__).resolve().parents[4] / "shared" / "tracks"

WORLDS = [
    "reinvent_base",
    "Bowtie_track",
    "Tokyo_Training_track",
    "Monaco",
    "reInvent2019_wide_cw",
    "hamption_pro",
    "Straight_track",
]


def ring(half_m: float) -> np.ndarray:
    """A square round the origin, counter-clockwise from its lower left corner, closed."""
    corners = [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]
    return half_m * np.array(corners, dtype=np.float64)


@pytest.fixture
def square() -> Track:
    """A square track: centre line 4 m a side from (-2, -2), 16 m round, 2 m wide."""
    return Track("square", ring(2.0), ring(1.0), ring(3.0), closed=True)


def route(world: str) -> Track:
    file = ROUTES / f"{world}.npy"
    if not file.is_file():
        pytest.skip(f"there is no folder of reference routes with {world}.npy")
    return load_track(str(file))


def points_around(track: Track, count: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, len(track.center), count)
    return track.center[rows] + rng.normal(0, 0.5, (count, 2))


def test_a_point_beside_a_straight_is_located_as_worked_by_hand(square):
    where = square.locate(np.array([[0.5, -2.25]]))

    assert square.length_m == 16.0
    assert where.distance_m[0] == 2.5
    assert where.center_xy[0].tolist() == [0.5, -2.0]
    assert where.from_center_m[0] == 0.25
    assert (where.previous[0], where.next[0], where.nearest[0]) == (0, 1, 1)
    assert where.track_width_m[0] == 2.0
    assert not where.left_of_center[0]


def test_borders_are_measured_from_the_centre_line_point_and_not_from_the_car(square):
    # Nearest centre point is the corner (2, -2): inner (1, -1), and outer (2, -3) comes before
    # (3, -2) on its ring. Measured from the car at (2.5, -2.75), outer would be (2.5, -3).
    where = square.locate(np.array([[2.5, -2.75]]))

    assert where.center_xy[0].tolist() == [2.0, -2.0]
    assert where.track_width_m[0] == pytest.approx(np.hypot(1, 2))


def test_a_point_on_a_waypoint_has_that_waypoint_behind_it(square):
    where = square.locate(square.center)

    assert where.previous.tolist() == [0, 1, 2, 3, 0]
    assert where.next.tolist() == [1, 2, 3, 4, 1]


def test_the_last_piece_of_a_lap_leads_to_the_closing_waypoint(square):
    where = square.locate(np.array([[-2.0, -1.5]]))

    assert (where.previous[0], where.next[0], where.nearest[0]) == (3, 4, 4)
    assert where.distance_m[0] == 15.5


def test_beyond_the_end_of_an_open_track_the_next_waypoint_wraps_to_the_first():
    line = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    up = np.array([0.0, 1.0])
    track = Track("strip", line, line + up, line - up, closed=False)

    where = track.locate(np.array([[5.0, 0.5], [-5.0, 0.5]]))

    assert where.distance_m.tolist() == [2.0, 0.0]
    assert where.previous.tolist() == [2, 0]
    assert where.next.tolist() == [0, 1]


def test_left_and_right_swap_when_the_track_is_driven_the_other_way(square):
    inside, outside = [0.0, -1.5], [0.0, -2.5]

    forward = square.locate(np.array([inside, outside]))
    backward = square.reversed().locate(np.array([inside, outside]))

    assert forward.left_of_center.tolist() == [True, False]
    assert backward.left_of_center.tolist() == [False, True]


def test_a_reversed_track_runs_through_the_same_waypoints_backwards(square):
    back = square.reversed()

    assert back.reverse
    assert not back.is_ccw
    assert back.waypoints == square.waypoints[::-1]
    assert back.reversed().waypoints == square.waypoints
    assert not back.reversed().reverse


def test_a_wheel_exactly_on_a_border_is_off_the_road(square):
    on_borders = [[3.0, 0.0], [-3.0, 3.0], [0.0, -3.0], [1.0, 0.5], [1.0, 1.0], [0.0, 1.0]]
    just_inside = [[2.999999, 0.0], [1.000001, 0.5], [0.0, -2.999999]]

    assert not square.on_road(np.array(on_borders)).any()
    assert square.on_road(np.array(just_inside)).all()


def test_on_road_answers_in_the_shape_it_was_asked(square):
    wheels = np.full((5, 4, 2), 2.0)

    assert square.on_road(wheels).shape == (5, 4)


def test_poses_on_the_lanes_of_the_square_are_as_worked_by_hand(square):
    center = square.pose_at(np.array([0.0, 5.0, 18.0, -1.0]))
    outer = square.pose_at(np.array([5.0]), "outer")
    inner = square.pose_at(np.array([4.0]), "inner")

    half_pi = np.pi / 2
    np.testing.assert_allclose(
        center, [[-2, -2, 0], [2, -1, half_pi], [0, -2, 0], [-2, -1, -half_pi]]
    )
    np.testing.assert_allclose(outer, [[2.5, -1, half_pi]])
    np.testing.assert_allclose(inner, [[1.5, -1.5, half_pi]])


def test_poses_on_an_open_track_stop_at_its_ends():
    line = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    out = np.array([-0.5, 0.5])
    track = Track("bend", line, line + out, line - out, closed=False)

    poses = track.pose_at(np.array([-1.0, 99.0]))

    np.testing.assert_allclose(poses, [[0, 0, 0], [1, 2, np.pi / 2]])


def test_the_arrays_of_a_track_cannot_be_altered_by_accident(square):
    with pytest.raises(ValueError, match="read-only"):
        square.center[0, 0] = 7.0


def test_bounds_enclose_both_borders(square):
    assert square.bounds == (-3.0, -3.0, 3.0, 3.0)


@pytest.mark.parametrize("world", WORLDS)
def test_locations_agree_with_shapely(world):
    track = route(world)
    points = points_around(track, 300)
    shapes = shapely.LinearRing if track.closed else shapely.LineString
    center, inner, outer = shapes(track.center), shapes(track.inner), shapes(track.outer)
    seen = shapely.points(points)
    expected_m = shapely.line_locate_point(center, seen)
    on_center = shapely.line_interpolate_point(center, expected_m)
    on_inner, on_outer = (
        shapely.line_interpolate_point(line, shapely.line_locate_point(line, on_center))
        for line in (inner, outer)
    )

    where = track.locate(points)

    assert track.length_m == pytest.approx(center.length, abs=1e-9)
    np.testing.assert_allclose(where.distance_m, expected_m, atol=1e-9)
    np.testing.assert_allclose(where.from_center_m, shapely.distance(seen, center), atol=1e-9)
    np.testing.assert_allclose(where.track_width_m, shapely.distance(on_inner, on_outer), atol=1e-9)
    nearer_inner = shapely.distance(seen, on_inner) < shapely.distance(seen, on_outer)
    np.testing.assert_array_equal(where.left_of_center, nearer_inner ^ (not track.is_ccw))
    if track.closed:
        assert track.is_ccw == center.is_ccw


@pytest.mark.parametrize("world", WORLDS)
def test_being_on_the_road_agrees_with_shapely(world):
    track = route(world)
    points = np.concatenate([points_around(track, 500), track.inner, track.outer])
    if track.closed:
        road = shapely.Polygon(track.outer, [track.inner])
    else:
        road = shapely.Polygon(np.concatenate([track.outer, track.inner[::-1]]))

    got = track.on_road(points)

    np.testing.assert_array_equal(got, shapely.contains_xy(road, points))
    assert 0 < got.mean() < 1


@pytest.mark.parametrize("world", WORLDS)
def test_previous_and_next_enclose_the_projection(world):
    track = route(world)
    steps_m = [np.hypot(bx - ax, by - ay) for (ax, ay), (bx, by) in pairwise(track.waypoints)]
    waypoint_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    waypoint_m[-1] = track.length_m

    where = track.locate(points_around(track, 300))

    following = np.searchsorted(waypoint_m, where.distance_m, side="right")
    np.testing.assert_array_equal(where.next, following % len(waypoint_m))
    np.testing.assert_array_equal(where.previous, following - 1)
    both = np.stack([where.previous, where.next])
    apart_m = np.hypot(*(track.center[both] - points_around(track, 300)).transpose(2, 0, 1))
    nearer = np.where(apart_m[0] <= apart_m[1], where.previous, where.next)
    np.testing.assert_array_equal(where.nearest, nearer)


@settings(max_examples=40)
@given(
    distance_m=st.floats(-40.0, 40.0),
    across_m=st.floats(-0.35, 0.35),
    backwards=st.booleans(),
)
def test_a_point_put_beside_the_centre_line_is_found_there(distance_m, across_m, backwards):
    track = load_track("reinvent_base")
    track = track.reversed() if backwards else track
    x, y, yaw_rad = track.pose_at(np.array([distance_m]))[0]
    beside = np.array([[x - across_m * np.sin(yaw_rad), y + across_m * np.cos(yaw_rad)]])

    where = track.locate(beside)

    # At a bend the neighbouring piece can be nearer, so the point lies off it by a little less.
    assert abs(across_m) - 0.02 < where.from_center_m[0] <= abs(across_m) + 1e-9
    around_m = abs(where.distance_m[0] - distance_m) % track.length_m
    assert min(around_m, track.length_m - around_m) < 0.2
    assert track.on_road(beside)[0]
    if abs(across_m) > 0.02:
        assert where.left_of_center[0] == (across_m > 0)


@settings(max_examples=40)
@given(
    x=st.floats(allow_nan=True, allow_infinity=True),
    y=st.floats(allow_nan=True, allow_infinity=True),
)
def test_no_point_however_far_breaks_the_search(x, y):
    track = load_track("reinvent_base")

    where = track.locate(np.array([[x, y]]))

    assert 0 <= where.previous[0] < len(track.center)
    assert 0 <= where.next[0] < len(track.center)

"""Waypoints as racers and traces count them: the rows of the file, repeated ones included."""

import bisect
from pathlib import Path

import numpy as np
import pytest
import shapely

from drsim.episode.simulation import Simulation
from drsim.track.route_files import read_route
from drsim.track.track import Track
from drsim.track.worlds import load_track

ROUTES = Path(__file__).resolve().parents[4] / "shared" / "tracks"

needs_routes = pytest.mark.skipif(
    not ROUTES.is_dir(), reason="there is no folder of community routes beside the repository"
)

REPEATED = 3
"""Row that repeats the one before, on the track that is driven."""


def square(*rows: int) -> Track:
    """A square 16 m round, of the rows given: corners, and 4 closes the loop."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    lines = (size * corners[list(rows)] for size in (2.0, 1.0, 3.0))
    return Track("square", *lines, closed=True)


@pytest.fixture
def repeated_square() -> Track:
    """Waypoints 2 and 3 are the corner (2, 2), where the second side ends."""
    return square(0, 1, 2, 2, 3, 4)


def counted(track: Track, *points: tuple[float, float]) -> list[tuple[int, int, int]]:
    """Previous, next and nearest waypoint of each point."""
    where = track.locate(np.array(points))
    columns = (where.previous, where.next, where.nearest)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def test_before_a_repeated_waypoint_its_first_number_lies_ahead_and_after_it_its_last_one_behind(
    repeated_square,
):
    before, after, beyond = (2.1, 1.5), (1.5, 2.1), (-1.5, 2.1)

    found = counted(repeated_square, before, after, beyond)

    assert found == [(1, 2, 2), (3, 4, 3), (3, 4, 4)]


def test_on_the_outside_of_a_bend_at_a_repeated_waypoint_the_car_has_passed_it(repeated_square):
    assert counted(repeated_square, (2.0, 2.0), (2.5, 2.25)) == [(3, 4, 3)] * 2


def test_driven_the_other_way_numbers_count_from_the_other_end(repeated_square):
    back = repeated_square.reversed()
    before, after = (1.5, 2.1), (2.1, 1.5)

    assert back.waypoints == repeated_square.waypoints[::-1]
    # Rows of the file 5 4 [3 2] 1 0: the repeated corner has the numbers 2 and 3 again.
    assert counted(back, before, after, (2.5, 2.25)) == [(1, 2, 2), (3, 4, 3), (3, 4, 3)]


def test_a_row_repeated_at_the_start_or_before_the_finish_counts_too():
    start, finish = square(0, 0, 1, 2, 3, 4), square(0, 1, 2, 3, 4, 4)
    first_side, last_side = (-1.5, -2.1), (-2.1, -1.5)

    assert counted(start, first_side, last_side) == [(1, 2, 1), (4, 5, 5)]
    assert counted(finish, first_side, last_side) == [(0, 1, 0), (3, 4, 4)]
    assert counted(start.reversed(), last_side, first_side) == [(0, 1, 0), (3, 4, 4)]
    assert counted(finish.reversed(), last_side, first_side) == [(1, 2, 1), (4, 5, 5)]


def test_repeated_rows_change_nothing_that_is_measured(repeated_square):
    plain = square(0, 1, 2, 3, 4)
    points = np.random.default_rng(3).uniform(-3.5, 3.5, (200, 2))

    there, here = plain.locate(points), repeated_square.locate(points)

    assert repeated_square.length_m == plain.length_m
    for name in ("distance_m", "center_xy", "from_center_m", "track_width_m", "left_of_center"):
        np.testing.assert_array_equal(getattr(here, name), getattr(there, name))
    np.testing.assert_array_equal(repeated_square.on_road(points), plain.on_road(points))
    for lane in ("center", "inner", "outer"):
        at_m = np.linspace(0.0, 16.0, 33)
        np.testing.assert_array_equal(
            repeated_square.pose_at(at_m, lane), plain.pose_at(at_m, lane)
        )


@pytest.mark.parametrize("reverse", [False, True])
def test_reward_function_and_trace_count_the_rows_of_the_route(reverse):
    base = load_track("reinvent_base")
    rows = [*range(REPEATED), *range(REPEATED - 1, 119)]
    if reverse:  # then the repeated row comes soon after the start as well
        rows = [118 - row for row in reversed(rows)]
    track = Track("mine", base.center[rows], base.inner[rows], base.outer[rows], closed=True)
    driven = track.reversed() if reverse else track
    told, nearest = [], []
    simulation = Simulation(
        track, num_cars=1, reward_function=lambda params: told.append(params) or 1.0
    )
    try:
        simulation.reset(np.zeros(1, np.int64), np.zeros(1), reverse=reverse)
        for _ in range(15):
            result = simulation.step(np.zeros(1), np.ones(1))
            nearest.append(int(result.closest_waypoint[0]))
    finally:
        simulation.close()

    pairs = [tuple(params["closest_waypoints"]) for params in told]
    assert told[0]["waypoints"] == driven.waypoints
    assert len(driven.waypoints) == 120
    assert list(dict.fromkeys(pairs))[:3] == [(1, 2), (3, 4), (4, 5)]
    assert list(dict.fromkeys(nearest))[:4] == [1, 2, 3, 4]


def reference_waypoints(rows: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Previous, next and nearest waypoint as the reference defines them, worked with shapely.

    Each waypoint and each point is projected on the line; the next waypoint is the first whose
    share of the length is greater, and the nearest of the two the nearer by straight distance.
    """
    closed = (rows[0] == rows[-1]).all()
    line = (shapely.LinearRing if closed else shapely.LineString)(rows[:, :2])
    at = [*shapely.line_locate_point(line, shapely.points(rows[:-1, :2]), normalized=True), 1.0]
    places = shapely.line_locate_point(line, shapely.points(points), normalized=True)
    # At a waypoint itself the two projections may differ by rounding.
    following = np.array([bisect.bisect_right(at, place + 1e-12) for place in places])
    previous, following = following - 1, following % len(at)
    to_previous_m, to_next_m = (
        np.hypot(*(rows[numbers, :2] - points).T) for numbers in (previous, following)
    )
    return previous, following, np.where(to_next_m < to_previous_m, following, previous)


@needs_routes
def test_all_127_routes_count_waypoints_like_the_reference_in_both_directions():
    random = np.random.default_rng(12)
    files, with_repeats = sorted(ROUTES.glob("*.npy")), 0
    for file in files:
        rows = np.load(file)
        repeats = np.flatnonzero((rows[1:, :2] == rows[:-1, :2]).all(axis=1))
        with_repeats += len(repeats) > 0
        near = np.concatenate([random.integers(0, len(rows), 60), np.repeat(repeats, 20)])
        points = rows[near, :2] + random.normal(0.0, 0.25, (len(near), 2))
        track = read_route(file)

        for driven, order in ((track, rows), (track.reversed(), rows[::-1])):
            where = driven.locate(points)

            assert driven.waypoints == [tuple(row) for row in order[:, :2].tolist()]
            previous, following, nearest = reference_waypoints(order, points)
            np.testing.assert_array_equal(where.previous, previous, err_msg=file.name)
            np.testing.assert_array_equal(where.next, following, err_msg=file.name)
            np.testing.assert_array_equal(where.nearest, nearest, err_msg=file.name)
    assert (len(files), with_repeats) == (127, 59)


@needs_routes
def test_on_all_127_routes_the_trace_names_the_row_of_the_file_that_is_nearest_to_the_car():
    random = np.random.default_rng(7)
    agreeing = []
    for file in sorted(ROUTES.glob("*.npy")):
        rows, track = np.load(file), read_route(file)
        at_m = random.uniform(0.0, track.length_m, 100)
        points = track.pose_at(at_m)[:, :2] + random.normal(0.0, 0.05, (100, 2))

        nearest = track.locate(points).nearest

        apart_m = np.hypot(*(rows[None, :, :2] - points[:, None]).transpose(2, 0, 1))
        named_m = apart_m[np.arange(100), nearest]
        agreeing.append(named_m <= apart_m.min(axis=1) + 1e-9)
    # Inside a tight bend the nearest row may be one that is not beside the car along the line.
    assert np.mean(agreeing) > 0.999

"""Track geometry on random closed routes and on our own worlds, with shapely as the judge."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track

COARSE_M = 1e-7
"""Two stretches of a line nearer than this are equally near, and either may be found."""


@st.composite
def routes(draw):
    """A loop that does not cross itself: a distance from a centre for each direction."""
    count = draw(st.integers(4, 40))
    radii = draw(st.lists(st.floats(2.0, 6.0), min_size=count, max_size=count))
    shifts = draw(st.lists(st.floats(-0.3, 0.3), min_size=count, max_size=count))
    x_m, y_m = draw(st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)))
    angles = 2 * np.pi * (np.arange(count) + np.array(shifts)) / count
    if draw(st.booleans()):  # clockwise
        angles = angles[::-1]
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    half_m = draw(st.floats(0.05, 0.9))
    lines = []
    for offset_m in (0.0, -half_m, half_m):
        line = np.array([x_m, y_m]) + ways * (np.array(radii) + offset_m)[:, None]
        lines.append(np.concatenate([line, line[:1]]))
    track = Track("random", *lines, closed=True)
    return track.reversed() if draw(st.booleans()) else track


LOOPS = [name for name in known_worlds() if load_track(name).closed]


@st.composite
def tracks(draw):
    """A random route, or one of our own loops in either direction."""
    if draw(st.booleans()):
        return draw(routes())
    track = load_track(draw(st.sampled_from(LOOPS)))
    return track.reversed() if draw(st.booleans()) else track


def points_near(track: Track, seed: int, count: int = 40):
    """Points on, beside and far from a track, waypoints and midpoints of pieces among them."""
    random = np.random.default_rng(seed)
    x_min, y_min, x_max, y_max = track.bounds
    anywhere = random.uniform([x_min - 2, y_min - 2], [x_max + 2, y_max + 2], (count, 2))
    rows = random.integers(0, len(track.center) - 1, count)
    share = random.random((count, 1))
    on_line = track.center[rows] * share + track.center[rows + 1] * (1 - share)
    beside = on_line + random.normal(0.0, 0.3, (count, 2))
    return np.concatenate([anywhere, on_line, beside, track.center[rows[:8]]])


def ring(line):
    return shapely.LinearRing(line)


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_the_nearest_point_of_the_centre_line_is_shapelys(track, seed):
    points = points_near(track, seed)
    center, seen = ring(track.center), shapely.points(points)

    where = track.locate(points)

    away_m = shapely.distance(seen, center)
    assert track.length_m == pytest.approx(center.length, rel=1e-12)
    np.testing.assert_allclose(where.from_center_m, away_m, atol=1e-9)
    on_line_m = shapely.distance(shapely.points(where.center_xy), center)
    np.testing.assert_allclose(on_line_m, 0.0, atol=1e-9)
    there = shapely.line_interpolate_point(center, where.distance_m)
    np.testing.assert_allclose(shapely.get_coordinates(there), where.center_xy, atol=1e-8)
    expected_m = shapely.line_locate_point(center, seen)
    gap_m = np.abs(where.distance_m - expected_m)
    same = np.minimum(gap_m, track.length_m - gap_m) < 1e-6
    # Where two stretches are equally near, shapely may name the other one.
    other = shapely.distance(seen, shapely.line_interpolate_point(center, expected_m))
    assert (same | (np.abs(other - away_m) < COARSE_M)).all()


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_the_waypoints_around_a_point_enclose_it_and_the_nearer_one_is_closest(track, seed):
    points = points_near(track, seed)
    pieces_m = np.hypot(*np.diff(track.center, axis=0).T)
    waypoint_m = np.concatenate([[0.0], np.cumsum(pieces_m)])

    where = track.locate(points)

    last = len(track.center) - 1
    assert ((where.previous >= 0) & (where.previous <= last)).all()
    np.testing.assert_array_equal(where.next, (where.previous + 1) % (last + 1))
    assert (waypoint_m[where.previous] <= where.distance_m + 1e-9).all()
    ahead_m = np.where(where.next == 0, np.inf, waypoint_m[where.next])
    assert (where.distance_m <= ahead_m + 1e-9).all()
    to_previous, to_next = (
        np.hypot(*(track.center[index] - points).T) for index in (where.previous, where.next)
    )
    nearest = np.where(to_previous <= to_next, where.previous, where.next)
    np.testing.assert_array_equal(where.nearest, nearest)


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_the_width_is_measured_between_the_projections_on_both_borders(track, seed):
    points = points_near(track, seed)

    where = track.locate(points)

    middle = shapely.points(where.center_xy)
    on = [
        shapely.line_interpolate_point(line, shapely.line_locate_point(line, middle))
        for line in (ring(track.inner), ring(track.outer))
    ]
    clear = _one_nearest(middle, track.inner) & _one_nearest(middle, track.outer)
    width_m = shapely.distance(*on)
    np.testing.assert_allclose(where.track_width_m[clear], width_m[clear], atol=1e-6)


def _one_nearest(points, line):
    """Whether only one piece of a line, or two that join, are nearest to each point."""
    pieces = shapely.linestrings(np.stack([line[:-1], line[1:]], axis=1))
    away_m = shapely.distance(points[:, None], pieces[None, :])
    ties = away_m < away_m.min(axis=1, keepdims=True) + COARSE_M
    joined = ties & (np.roll(ties, 1, axis=1) | np.roll(ties, -1, axis=1))
    return (ties.sum(axis=1) == 1) | ((ties.sum(axis=1) == 2) & (joined.sum(axis=1) == 2))


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_a_wheel_is_on_the_road_exactly_if_it_lies_inside_shapelys_polygon(track, seed):
    points = np.concatenate([points_near(track, seed), track.inner[:5], track.outer[:5]])
    road = shapely.Polygon(track.outer, [track.inner])

    on = track.on_road(points)

    # On the border itself the two may differ by a rounding of the coordinates.
    clear = shapely.distance(shapely.points(points), road.boundary) > 1e-9
    np.testing.assert_array_equal(on[clear], shapely.contains_xy(road, points[clear]))
    assert not on[-10:].any()


@settings(max_examples=40)
@given(track=tracks(), distance_m=st.floats(-200.0, 200.0))
def test_a_pose_on_the_centre_line_lies_there_and_looks_along_its_piece(track, distance_m):
    center = ring(track.center)

    x, y, yaw_rad = track.pose_at(np.array([distance_m]))[0]

    expected = shapely.line_interpolate_point(center, distance_m % track.length_m)
    assert shapely.distance(shapely.Point(x, y), expected) < 1e-8
    # A little further on the same piece, the line has gone the way that the pose looks.
    ways = np.diff(track.center, axis=0)
    turns = np.abs((np.arctan2(ways[:, 1], ways[:, 0]) - yaw_rad + np.pi) % (2 * np.pi) - np.pi)
    pieces = shapely.linestrings(np.stack([track.center[:-1], track.center[1:]], axis=1))
    here = shapely.distance(pieces, shapely.Point(x, y)) < 1e-8
    assert turns[here].min() < 1e-9


@settings(max_examples=40)
@given(track=tracks(), laps=st.integers(-3, 3), distance_m=st.floats(0.0, 1.0, exclude_max=True))
def test_whole_laps_change_no_pose(track, laps, distance_m):
    along_m = distance_m * track.length_m
    once = track.pose_at(np.array([along_m]))[0]

    again = track.pose_at(np.array([along_m + laps * track.length_m]))[0]

    assert np.hypot(*(once - again)[:2]) < 1e-8


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_driven_the_other_way_distances_add_up_to_a_lap_and_sides_swap(track, seed):
    points = points_near(track, seed)

    there, back = track.locate(points), track.reversed().locate(points)

    lap_m = there.distance_m + back.distance_m
    off_m = np.abs(lap_m) % track.length_m
    np.testing.assert_allclose(np.minimum(off_m, track.length_m - off_m), 0.0, atol=1e-9)
    np.testing.assert_array_equal(there.left_of_center, ~back.left_of_center)
    assert track.is_ccw != track.reversed().is_ccw


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_a_car_that_turns_round_is_told_the_same_figures_to_the_last_bit(track, seed):
    points, back = points_near(track, seed), track.reversed()

    for other in (back, back.reversed()):
        assert other.length_m == track.length_m
        assert other.bounds == track.bounds
        np.testing.assert_array_equal(other.on_road(points), track.on_road(points))
        there, here = other.locate(points), track.locate(points)
        for name in ("center_xy", "from_center_m", "track_width_m"):
            np.testing.assert_array_equal(getattr(there, name), getattr(here, name))


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_a_car_that_turns_round_has_behind_it_what_was_ahead(track, seed):
    points, last = points_near(track, seed), len(track.center) - 1

    there, back = track.locate(points), track.reversed().locate(points)

    between = (there.center_xy[:, None] != track.center).any(axis=2).all(axis=1)
    np.testing.assert_array_equal(back.previous[between], last - there.next[between])
    np.testing.assert_array_equal(back.next[between], last - there.previous[between])
    # At a waypoint that one is behind the car, whichever way it looks.
    at = np.flatnonzero(~between)
    behind = track.center[np.stack([there.previous[at], last - back.previous[at]])]
    np.testing.assert_array_equal(behind, np.stack([there.center_xy[at]] * 2))


def test_a_route_is_as_long_as_the_same_rows_in_the_other_order():
    track = load_track("switchback")
    lines = (line[::-1].copy() for line in (track.center, track.inner, track.outer))

    assert Track("other", *lines, closed=True).length_m == track.length_m


def test_directions_along_a_track_do_not_depend_on_how_many_are_asked_for_at_once():
    track = load_track("switchback")
    at_m = np.linspace(0.0, track.length_m, 501)

    at_once = track.pose_at(at_m)[:, 2]

    x, y = np.diff(track.center, axis=0).T
    each = {math.atan2(*step) for step in zip(y.tolist(), x.tolist(), strict=True)}
    assert set(at_once.tolist()) <= each


@settings(max_examples=40)
@given(track=tracks(), seed=st.integers(0, 2**32 - 1))
def test_a_step_over_the_finish_line_is_as_short_along_the_line_as_elsewhere(track, seed):
    step_m = np.random.default_rng(seed).uniform(0.001, 0.02)
    poses = track.pose_at(np.array([-step_m / 2, step_m / 2]))

    before, after = track.locate(poses[:, :2]).distance_m

    assert (after - before) % track.length_m == pytest.approx(step_m, abs=1e-6)


FIGURES = """
import numpy as np
from drsim.track.worlds import known_worlds, load_track
for name in known_worlds():
    track = load_track(name)
    poses = track.pose_at(np.linspace(0.0, track.length_m, 500))
    print(name, track.length_m.hex(), hash((track.center.tobytes(), poses.tobytes())))
"""
"""Prints a line for each of our worlds, which differs if a single bit of its figures does."""


def test_our_worlds_are_the_same_numbers_on_a_processor_without_wide_instructions():
    wide = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    narrow = {"NPY_DISABLE_CPU_FEATURES": " ".join(wide), "OPENBLAS_CORETYPE": "Nehalem"}

    here, there = (
        subprocess.run(
            [sys.executable, "-c", FIGURES],
            env={**os.environ, "PYTHONHASHSEED": "0", **without},
            check=True,
            capture_output=True,
            text=True,
        ).stdout.splitlines()
        for without in ({}, narrow)
    )

    assert len(here) == len(known_worlds())
    assert here == there

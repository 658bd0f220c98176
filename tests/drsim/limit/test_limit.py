"""The fastest line of a car, its form as stations, and the driver that validates it."""

import numpy as np
import pytest

from drsim.car.car import CarBatch
from drsim.car.car_parameters import CarParameters
from drsim.limit.fastest_line import (
    BEYOND_M,
    GRIPS,
    SPEEDS_MPS,
    Line,
    NoLine,
    fastest_line,
    points_of,
    stations_of,
)
from drsim.limit.predictive_driver import Effort, drive_line
from drsim.track.track import Track
from drsim.track.worlds import load_track

RADIUS_M, HALF_WIDTH_M = 1.5, 0.3


def ring(radius_m: float, count: int = 90) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    circle = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    circle[-1] = circle[0]
    return circle


def circle() -> Track:
    borders = ring(RADIUS_M - HALF_WIDTH_M), ring(RADIUS_M + HALF_WIDTH_M)
    return Track("circle", ring(RADIUS_M), *borders, closed=True)


def line_at(radius_m: float, speed_mps: float) -> Line:
    xy = ring(radius_m)[:-1]
    return Line(xy, np.full(len(xy), speed_mps))


@pytest.mark.parametrize("car", GRIPS)
def test_on_a_circle_the_fastest_lap_is_the_best_of_all_concentric_ones(car):
    pytest.importorskip("casadi")
    grip = GRIPS[car]
    radius = np.linspace(RADIUS_M - HALF_WIDTH_M - BEYOND_M, RADIUS_M + HALF_WIDTH_M, 200)
    speed = np.linspace(1.0, grip.top_mps - 0.01, 2000)
    lateral = np.interp(speed, SPEEDS_MPS, grip.lateral_mps2)
    # Without acceleration, a part of the grip is left unused: braking a little would corner better.
    idle = grip.best_brake_mps2 / (grip.accelerate_mps2 + grip.best_brake_mps2)
    possible = speed[:, None] ** 2 / radius <= lateral[:, None] * np.sqrt(1.0 - idle**2)
    fastest = np.where(possible, speed[:, None], 0.0).max(axis=0)
    expected_s = (2.0 * np.pi * radius / fastest).min()

    line = fastest_line(circle(), grip)

    assert line.lap_s == pytest.approx(expected_s, rel=0.02)


def test_an_open_track_has_no_fastest_lap():
    track = circle()
    rows = slice(0, 60)
    road = Track("arc", track.center[rows], track.inner[rows], track.outer[rows], closed=False)

    with pytest.raises(NoLine, match="not a loop"):
        fastest_line(road, GRIPS["release-6"])


@pytest.mark.parametrize("backwards", [False, True])
def test_a_line_survives_its_way_through_stations(backwards):
    track = load_track("reinvent_base")
    track = track.reversed() if backwards else track
    aside = 0.2 * np.sin(np.linspace(0.0, 4.0 * np.pi, 200, endpoint=False))
    line = Line(points_of(track, aside), np.full(200, 2.0))

    stations = stations_of(track, line)

    again = Line(points_of(track, stations.offset_m), stations.speed_mps)
    assert again.lap_s == pytest.approx(line.lap_s, rel=0.005)
    assert np.abs(stations.offset_m).max() == pytest.approx(0.2, abs=0.01)
    assert (np.diff(stations.clock_s) >= 0.0).all()


def test_cars_go_on_from_a_state_as_the_one_it_was_taken_of():
    cars = CarBatch(2, 1)
    drive = (np.array([10.0, 10.0]), np.array([2.0, 2.0]))
    for _ in range(5):
        cars.drive(*drive)
    state = cars.state()
    cars.drive(*drive)
    expected = cars.origin_xy.copy()

    cars.drive(-drive[0], drive[1])
    cars.set_state(state)
    cars.drive(*drive)

    np.testing.assert_array_equal(cars.origin_xy, expected)


def test_the_driver_laps_clean_and_is_faster_than_a_line_that_is_slower_than_the_car():
    line = line_at(RADIUS_M, 2.0)

    lap = drive_line(circle(), line, CarParameters(), 1, Effort(copies=16, rounds=1, horizon=8))

    assert lap.flying_s is not None
    assert lap.standing_s is not None
    assert lap.flying_s < lap.standing_s < line.lap_s

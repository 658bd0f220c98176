"""Slip angle and speed from recorded positions."""

import numpy as np
import pytest

from drcli.analysis.report.map_section import REAR_M, driven_mps, slip_deg


def circle(slide_deg: float, radius_m: float = 1.5, steps: int = 30):
    """Recorded points of a car whose rear axle drives a circle to the left."""
    angle = np.linspace(0.0, 1.5, steps)
    rear = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    yaw_deg = np.degrees(angle) + 90.0 - slide_deg
    yaw_rad = np.radians(yaw_deg)
    ahead = REAR_M * np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=1)
    wrapped = (yaw_deg + 180.0) % 360.0 - 180.0
    return *(rear + ahead).T, wrapped


def first(steps: int) -> np.ndarray:
    return np.arange(steps) == 0


@pytest.mark.parametrize("slide_deg", [0.0, 8.0, -5.0])
def test_turning_alone_is_no_slip(slide_deg):
    x, y, yaw_deg = circle(slide_deg)

    slip = slip_deg(x, y, yaw_deg, first(30))

    assert np.isnan(slip[0])
    np.testing.assert_allclose(slip[1:], slide_deg, atol=0.05)


def test_a_standing_car_and_a_new_episode_have_no_slip():
    x = np.array([0.0, 0.0, 0.001, 5.0, 5.1])
    starts = np.array([True, False, False, True, False])

    slip = slip_deg(x, np.zeros(5), np.zeros(5), starts)

    assert np.isnan(slip[:4]).all()
    assert slip[4] == pytest.approx(0.0)


def test_the_speed_is_that_over_ground():
    x = np.array([0.0, 0.1, 0.3, 9.0, 9.0, 9.1])
    time_s = np.array([0.0, 0.1, 0.2, 0.3, 0.3, 0.4])

    speed = driven_mps(x, np.zeros(6), time_s, first(6))

    np.testing.assert_allclose(speed, [np.nan, 1.0, 2.0, np.nan, np.nan, 1.0])


@pytest.mark.parametrize("steps", [0, 1])
def test_a_trace_without_motion_has_neither(steps):
    nothing = np.zeros(steps)

    assert np.isnan(slip_deg(nothing, nothing, nothing, first(steps))).all()
    assert np.isnan(driven_mps(nothing, nothing, nothing, first(steps))).all()

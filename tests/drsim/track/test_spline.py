"""The closed spline that our own worlds are drawn with."""

import numpy as np

from drsim.track.worlds import ClosedSpline


def circle_points(count: int, radius_m: float) -> np.ndarray:
    angle_rad = np.arange(count) * 2 * np.pi / count
    return radius_m * np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)


def test_a_spline_through_points_of_a_circle_is_nearly_that_circle():
    spline = ClosedSpline(circle_points(16, radius_m=2.0))

    xy, direction = spline.at(np.linspace(0, spline.length_m, 50))

    np.testing.assert_allclose(np.hypot(*xy.T), 2.0, atol=5e-4)
    np.testing.assert_allclose(spline.length_m, 4 * np.pi, atol=2e-3)
    np.testing.assert_allclose(np.sum(xy * direction, axis=1), 0.0, atol=5e-3)


def test_a_spline_passes_through_its_points_and_returns_to_the_first():
    points = np.array([[0.0, 0.0], [3.0, 0.2], [4.0, 2.0], [1.0, 3.0], [-0.5, 1.0]])
    spline = ClosedSpline(points)

    dense, _ = spline.at(np.linspace(0, spline.length_m, 20_000))

    apart_m = np.hypot(*(dense[:, None] - points[None]).transpose(2, 0, 1)).min(axis=0)
    np.testing.assert_allclose(apart_m, 0.0, atol=1e-3)
    np.testing.assert_allclose(dense[0], dense[-1], atol=1e-9)


def test_a_spline_has_no_kink_at_its_points():
    spline = ClosedSpline(np.array([[0.0, 0.0], [3.0, 0.2], [4.0, 2.0], [1.0, 3.0], [-0.5, 1.0]]))
    step_m = 0.001

    _, direction = spline.at(np.arange(0, spline.length_m, step_m))

    turn = np.hypot(*np.diff(direction, axis=0).T) / step_m
    jump = np.abs(np.diff(turn))
    assert jump.max() < 0.1  # curvature per metre changes little by little, at the points too


def test_distances_along_a_spline_are_true_lengths():
    spline = ClosedSpline(circle_points(5, radius_m=1.0) * [2.0, 1.0])

    xy, _ = spline.at(np.linspace(0, spline.length_m, 10_001))

    step_m = np.hypot(*np.diff(xy, axis=0).T)
    np.testing.assert_allclose(step_m, spline.length_m / 10_000, rtol=1e-2)

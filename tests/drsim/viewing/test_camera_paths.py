"""The cameras of videos: one swings after a car, one has the whole track in view."""

import math

import numpy as np
import pytest

from drsim.track.track import Track
from drsim.viewing.car_eye import FollowingCamera, lens_above


def square_track(half_m: float) -> Track:
    """A square road 1 m wide around the origin."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    inner, outer = corners * (half_m - 0.5), corners * (half_m + 0.5)
    return Track("square", corners * half_m, inner, outer, closed=True)


def yaw_of(lens):
    return math.atan2(lens.mat[1, 0], lens.mat[0, 0])


def test_the_camera_behind_swings_after_a_turning_car():
    camera = FollowingCamera()
    camera.lens((-1.0, -2.0, 0.0))

    yaws = [yaw_of(camera.lens((-1.0, -2.0, 0.6))) for _ in range(30)]

    assert 0.0 < yaws[0] < yaws[3] < yaws[29]
    assert yaws[3] == pytest.approx(0.6 * (1.0 - math.exp(-4 / 15 / 0.25)))
    assert yaws[29] == pytest.approx(0.6, abs=0.001)


def test_a_car_put_elsewhere_is_seen_along_its_new_direction_at_once():
    camera = FollowingCamera()
    camera.lens((0.0, -2.0, 0.0))

    assert yaw_of(camera.lens((2.0, 0.0, 1.5))) == pytest.approx(1.5)


def test_the_camera_turns_the_short_way_where_the_yaw_wraps():
    camera = FollowingCamera()
    camera.lens((1.0, 2.0, math.pi - 0.01))

    assert abs(yaw_of(camera.lens((1.0, 2.0, -math.pi + 0.01)))) > math.pi - 0.02


@pytest.mark.parametrize("half_m", [0.6, 2.0, 40.0])
@pytest.mark.parametrize("size", [(480, 640), (720, 1280)])
def test_the_whole_track_is_in_view_from_above(half_m, size):
    lens = lens_above(square_track(half_m), size)

    rows, columns = size
    pixel_m = 2.0 * lens.pos[2] * math.tan(0.5 * lens.field_of_view_rad) / columns
    track_px = (2.0 * half_m + 1.0) / pixel_m
    assert 0.7 * rows < track_px < rows
    np.testing.assert_allclose(lens.mat[:, 0], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(lens.mat[:, 1], [-1.0, 0.0, 0.0], atol=1e-12)

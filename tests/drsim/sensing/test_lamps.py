"""Glare and reflections: light in a camera picture, where the geometry says. Seed 003-19."""

import numpy as np
import pytest

from drsim.car.car import FRONT
from drsim.sensing.lighting import Lamps
from drsim.sensing.scene import build_scene, lens_parts, render
from drsim.track.appearance import Look, Walls
from drsim.track.track import Track

FOCAL = FRONT.focal_px


@pytest.fixture(scope="module")
def scene():
    """A straight road of 20 m between walls."""
    x = np.linspace(0.0, 20.0, 11)
    center, inner, outer = (np.column_stack([x, np.full(11, y)]) for y in (0.0, 0.5, -0.5))
    return build_scene(
        Track("straight", center, inner, outer, closed=False),
        Look(walls=Walls(height_m=0.6, greys=(0.0, 0.0, 0.0, 0.0)), sky_grey=0.0),
    )


def level_lens(x: float = 5.0, yaw_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    axes = np.array([[[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]])
    return np.array([[x, 0.0, 0.15]]), axes


def lit(scene, place, *, glare=0.0, reflections=0.0, yaw_rad=0.0) -> np.ndarray:
    """How much brighter each pixel is than without the one lamp. Shape (120, 160)."""
    lamps = Lamps(scene, 1)
    lamps.begin(0, glare=glare, reflections=reflections, pattern=1)
    lamps._floodlight_m[:] = place
    lamps._lamps_m = np.array([[place]], np.float64)
    frames = np.zeros((2, 1, 120, 160), np.uint8)
    rows = slice(0, 1)
    for frame in frames:
        render(scene, *level_lens(yaw_rad=yaw_rad), frame)
    lenses = lens_parts(*level_lens(yaw_rad=yaw_rad))
    lamps.reflect(rows, frames[1], lenses)
    lamps.shine(rows, frames[1], lenses)
    return frames[1, 0].astype(float) - frames[0, 0]


def middle(light: np.ndarray) -> tuple[float, float]:
    """Column and row of the middle of the brightest part."""
    rows, columns = np.nonzero(light > 0.7 * light.max())
    return columns.mean() + 0.5, rows.mean() + 0.5


def test_a_mirrored_lamp_stands_where_a_mirror_would_show_it(scene):
    ahead, left, height = 9.0, 1.0, 3.0

    light = lit(scene, (5.0 + ahead, left, height), reflections=0.5)

    column, row = middle(light)
    assert column == pytest.approx(80 - FOCAL * left / ahead, abs=1.0)
    assert row == pytest.approx(60 + FOCAL * (height + 0.15) / ahead, abs=1.5)
    assert light.min() == 0, "nothing else changes"
    assert (light[:60] == 0).all(), "nothing above the horizon"


def test_a_mirrored_lamp_is_longer_than_wide_and_soft(scene):
    light = lit(scene, (13.0, 0.0, 3.0), reflections=0.4)

    bright = light > 0.5 * light.max()
    assert bright.any(axis=1).sum() > 1.5 * bright.any(axis=0).sum()
    assert np.abs(np.diff(light, axis=0)).max() < 0.4 * light.max()


def test_flat_light_is_mirrored_more(scene):
    near, far = (
        lit(scene, (5.0 + ahead, 0.0, 3.0), reflections=0.05).max() for ahead in (8.0, 14.0)
    )

    assert far > 1.5 * near > 0


def test_a_lamp_behind_the_car_is_not_mirrored(scene):
    assert (lit(scene, (1.0, 0.0, 3.0), reflections=1.0) == 0).all()


def test_strength_scales_what_the_floor_mirrors(scene):
    weak, strong = (lit(scene, (11.0, 0.0, 3.0), reflections=share).max() for share in (0.1, 0.3))

    assert strong == pytest.approx(3 * weak, rel=0.1)


def test_glare_is_brightest_at_the_lamp_and_falls_off_around_it(scene):
    ahead, left, height = 10.0, 1.0, 2.0

    light = lit(scene, (5.0 + ahead, left, height), glare=0.6)

    column, row = middle(light)
    assert column == pytest.approx(80 - FOCAL * left / ahead, abs=1.5)
    assert row == pytest.approx(60 - FOCAL * (height - 0.15) / ahead, abs=1.5)
    ring = [light[int(row), int(column) + step] for step in (0, 15, 30, 60)]
    assert ring == sorted(ring, reverse=True)
    assert ring[0] > ring[3] + 60


def test_glare_takes_contrast_from_the_whole_picture(scene):
    """White lines and road come closer: haze, and an exposure for the lamp."""
    light = lit(scene, (16.0, 0.0, 1.6), glare=1.0)
    plain = np.zeros((1, 120, 160), np.uint8)
    render(scene, *level_lens(), plain)
    line, road = plain[0] > 200, plain[0] < 90
    line[:70], road[:70] = False, False

    assert min(line.sum(), road.sum()) > 100
    assert light[line].mean() < light[road].mean() - 20


@pytest.mark.parametrize("yaw_rad", [np.pi / 2, np.pi])
def test_a_lamp_at_the_side_or_behind_does_not_dazzle(scene, yaw_rad):
    assert (lit(scene, (15.0, 0.0, 1.5), glare=1.0, yaw_rad=yaw_rad) == 0).all()


def test_the_pattern_decides_where_lamps_are_and_all_hang_outside_and_above(scene):
    lamps = Lamps(scene, 50)
    for car in range(50):
        lamps.begin(car, glare=1.0, reflections=1.0, pattern=car // 2)
    x, y, z = lamps._floodlight_m.T
    low_x, high_x, low_y, high_y = scene.walls_m

    np.testing.assert_array_equal(lamps._lamps_m[::2], lamps._lamps_m[1::2])
    assert len(np.unique(lamps._floodlight_m, axis=0)) == 25
    assert ((x < low_x) | (x > high_x) | (y < low_y) | (y > high_y)).all()
    assert (z > scene.wall_height_m).all()
    assert 2.5 < lamps._lamps_m[..., 2].min() < lamps._lamps_m[..., 2].max() < 4.3


def test_a_pose_that_is_not_finite_stays_black(scene):
    lamps = Lamps(scene, 1)
    lamps.begin(0, glare=1.0, reflections=1.0, pattern=0)
    frame = np.full((1, 120, 160), 7, np.uint8)
    pos, mat = level_lens()

    render(scene, pos * np.nan, mat, frame)
    lamps.reflect(slice(0, 1), frame, lens_parts(pos * np.nan, mat))
    lamps.shine(slice(0, 1), frame, lens_parts(pos * np.nan, mat))

    assert (frame == 0).all()

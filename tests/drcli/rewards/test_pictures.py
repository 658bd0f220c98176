"""Pictures: what is where in them, and what happens when they cannot be written."""

import io
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from PIL import Image

from drcli.rewards.pictures import Curve, curve_range, draw_comparison, draw_reward, number


def pixels(picture: bytes) -> np.ndarray:
    """Rows and columns of red, green and blue."""
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"))


def share_of(picture: np.ndarray, value: float) -> float:
    """Part of a picture in the colour of a value from 0 to 1."""
    color = np.array(matplotlib.colormaps["viridis"](value)[:3]) * 255
    return float((np.abs(picture - color) < 3).all(axis=-1).mean())


def test_the_map_is_bright_where_the_road_pays_and_dark_beside_it(course, tried_of):
    tried = tried_of(lambda params: 0.0 if params["is_offtrack"] else 1.0)

    picture = pixels(draw_reward(course, tried))

    assert share_of(picture, 1.0) > 3 * share_of(picture, 0.0) > 0.01


def test_the_picture_is_dark_text_on_white(course, tried_of):
    picture = pixels(draw_reward(course, tried_of(lambda params: params["x"])))

    assert (picture[0, 0] == 255).all()
    assert (picture == 255).all(axis=-1).mean() > 0.5


def test_a_constant_reward_and_any_name_of_a_file_can_be_drawn(course, tried_of):
    tried = replace(tried_of(lambda params: 1.0), name="赛道 $x$ }.py")

    assert share_of(pixels(draw_reward(course, tried)), 0.5) > 0.05


def test_obstacles_are_on_the_map(obstacle_course):
    assert obstacle_course.grid.objects.shape == (6, 4, 2)
    centers = obstacle_course.grid.objects.mean(axis=1)
    assert obstacle_course.drive.track.on_road(centers).all()


def test_two_functions_make_one_wide_picture(course, tried_of):
    first = tried_of(lambda params: 1.0 - params["distance_from_center"])
    second = tried_of(lambda params: params["speed"])

    picture = pixels(draw_comparison(course, first, second))

    assert picture.shape[1] >= 1400
    assert picture.shape[1] > picture.shape[0]
    assert picture.std() > 20


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (-0.25, "-0.25"), (1234.0, "1,234"), (2.5e-7, "2.5e-07")]
)
def test_numbers_are_short(value, text):
    assert number(value) == text


def test_a_finish_that_pays_much_more_is_cut_and_told():
    progress = np.linspace(0.0, 100.0, 50)
    values = np.where(progress == 100.0, 60.0, 1.0 + progress / 100.0)

    low, high, remark = curve_range([Curve("a", "black", progress, values)])

    assert (low, high) == (1.0, pytest.approx(2.0, abs=0.03))
    assert "60" in remark

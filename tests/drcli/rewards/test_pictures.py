"""Pictures: what is where in them, and what happens when they cannot be written."""

import errno
import os

import numpy as np
import pytest
from PIL import Image

from drcli.base.errors import SettingsError
from drcli.rewards import comparison_picture, plot
from drcli.rewards.canvas import (
    Canvas,
    diverging,
    number,
    refuse_replacing,
    sequential,
    ticks,
)
from drcli.rewards.panels import Curve


def brightness(picture: Image.Image) -> np.ndarray:
    return np.asarray(picture.convert("L"), dtype=float)


def test_the_map_is_bright_where_the_road_pays_and_dark_beside_it(trial_of, tmp_path):
    trial = trial_of(lambda params: 0.0 if params["is_offtrack"] else 1.0)

    plot.picture_of(trial).save(tmp_path / "reward.png")

    with Image.open(tmp_path / "reward.png") as picture:
        colors = np.asarray(picture.convert("RGB"))
    yellow, violet = (
        (colors == sequential(np.array(share))).all(axis=-1).sum() for share in (1.0, 0.0)
    )
    assert yellow > 3 * violet > 0


def test_obstacles_are_on_the_map(obstacle_course):
    assert obstacle_course.field.objects.shape == (6, 4, 2)
    centers = obstacle_course.field.objects.mean(axis=1)
    assert obstacle_course.drive.track.on_road(centers).all()


def test_two_functions_make_one_wide_picture(trial_of, tmp_path):
    first = trial_of(lambda params: 1.0 - params["distance_from_center"])
    second = trial_of(lambda params: params["speed"])

    comparison_picture.picture_of(first, second).save(tmp_path / "both.png")

    with Image.open(tmp_path / "both.png") as picture:
        assert picture.width > picture.height
        assert brightness(picture).std() > 20


def test_a_file_that_is_no_picture_is_not_drawn_over(tmp_path):
    own = tmp_path / "run.env"
    own.write_text("DR_WORKERS=1\n")

    with pytest.raises(SettingsError, match="is there already and no PNG picture"):
        refuse_replacing(own)


def test_an_older_picture_may_be_replaced(tmp_path):
    Canvas(20, 20).save(tmp_path / "old.png")

    refuse_replacing(tmp_path / "old.png")
    refuse_replacing(tmp_path / "none.png")


def test_a_full_disk_leaves_the_older_picture_and_no_other_file(tmp_path, monkeypatch):
    def refuse(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    Canvas(10, 10).save(tmp_path / "reward.png")
    before = (tmp_path / "reward.png").read_bytes()
    monkeypatch.setattr(os, "fsync", refuse)

    with pytest.raises(SettingsError, match="No space left") as caught:
        Canvas(20, 20).save(tmp_path / "reward.png")

    assert caught.value.remedy.startswith("Make room")
    assert [file.name for file in tmp_path.iterdir()] == ["reward.png"]
    assert (tmp_path / "reward.png").read_bytes() == before


def test_a_folder_that_is_not_there_is_told_before_anything_is_drawn(tmp_path):
    with pytest.raises(SettingsError, match="there is no folder"):
        refuse_replacing(tmp_path / "nowhere" / "reward.png")


def test_a_picture_that_cannot_be_written_is_refused_with_its_name(tmp_path):
    with pytest.raises(SettingsError, match=r"nowhere.reward\.png"):
        Canvas(10, 10).save(tmp_path / "nowhere" / "reward.png")


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (-3.0, 7.0, [-2.0, 0.0, 2.0, 4.0, 6.0]),
        (5.0, 5.0, [5.0]),
    ],
)
def test_axes_carry_round_numbers(low, high, expected):
    assert ticks(low, high) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (-0.25, "-0.25"), (1234.0, "1,234"), (2.5e-7, "2.5e-07")]
)
def test_numbers_are_short(value, text):
    assert number(value) == text


def test_a_finish_that_pays_much_more_is_cut_and_told():
    progress = np.linspace(0.0, 100.0, 50)
    values = np.where(progress == 100.0, 60.0, 1.0 + progress / 100.0)

    low, high, remark = plot.curve_range([Curve("a", (0, 0, 0), progress, values)])

    assert (low, high) == (1.0, pytest.approx(2.0, abs=0.03))
    assert "60" in remark


def test_colours_run_from_dark_to_bright_and_from_blue_to_red():
    lightness = sequential(np.linspace(0.0, 1.0, 20)).astype(float) @ [0.3, 0.6, 0.1]
    less, equal, more = diverging(np.array([-1.0, 0.0, 1.0])).astype(int)

    assert (np.diff(lightness) > 0).all()
    assert less[2] > less[0]
    assert more[0] > more[2]
    assert np.ptp(equal) < 10

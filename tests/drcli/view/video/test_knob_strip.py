"""The filmstrip of domain randomisation: which settings it shows, and what it says they draw."""

from dataclasses import fields

import numpy as np
import pytest
from PIL import Image

from drcli.config.loading import load_settings
from drcli.view.video import knob_strip
from drcli.view.video.knob_strip import KNOBS, SHOWN, draw_knobs
from drsim.car.conditions import Realism
from drsim.sensing.scene import build_scene
from drsim.track.worlds import load_track

TRACK = load_track("reinvent_base")


@pytest.fixture
def drawn(tmp_path):
    """The report for a run.env with this text, and the cells of its picture: setting by place."""

    def draw(run_env=""):
        race = load_settings(tmp_path, contents={"run.env": run_env.encode()}).race
        report = draw_knobs(race, TRACK, tmp_path / "knobs.png")
        sheet = np.asarray(Image.open(report.file)).astype(float)
        rows = np.split(sheet[: len(sheet) // len(KNOBS) * len(KNOBS)], len(KNOBS))
        width, height = knob_strip._SIZE
        cells = [
            [
                row[knob_strip._HEADING :][
                    :height, knob_strip._GAP + k * (width + knob_strip._GAP) :
                ][:, :width]
                for k in range(SHOWN + 1)
            ]
            for row in rows
        ]
        return {row.setting: row for row in report.knobs}, dict(
            zip([row.setting for row in report.knobs], cells, strict=True)
        )

    return draw


def test_every_range_that_changes_the_picture_has_a_row():
    scene = build_scene(TRACK)
    usual = knob_strip._frames(TRACK, scene, 1, Realism(), "nothing")
    changing = {
        field.name
        for field in fields(Realism)
        if not np.array_equal(
            knob_strip._frames(TRACK, scene, 20, Realism(**{field.name: 0.9}), "nothing"),
            np.repeat(usual, 20, axis=0),
        )
    }

    assert {knob.field for knob in KNOBS if knob.field} == changing
    assert {knob.randomize for knob in KNOBS} == {"nothing", "lights", "textures"}


def test_a_row_shows_what_the_setting_draws_and_an_example_where_it_is_off(drawn):
    rows, cells = drawn("DR_SIM_BRIGHTNESS=0.1\n")

    brightness, blur = rows["DR_SIM_BRIGHTNESS"], rows["DR_SIM_BLUR"]
    assert (brightness.value, brightness.example) == ("0.1", False)
    assert (blur.value, blur.example) == ("1", True)
    factors = [float(text.removeprefix("x ")) for text in brightness.drawn]
    assert all(0.9 <= factor <= 1.1 for factor in factors)
    usual, *shown = (cell.mean() for cell in cells["DR_SIM_BRIGHTNESS"])
    # Brightened greys end at 255, and the labels have two digits.
    assert [grey / usual for grey in shown] == pytest.approx(factors, abs=0.02)


def test_frames_of_a_row_differ_more_and_more_from_the_usual_one(drawn):
    _, cells = drawn()

    for setting, (usual, *shown) in cells.items():
        change = [np.abs(frame - usual).mean() for frame in shown]
        assert change == pytest.approx(sorted(change), abs=0.05), setting
        assert change[-1] > 1.0, setting

"""The judge: our camera sees what `mujoco.Renderer` draws of the same scene."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.nightly

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"


def test_our_camera_agrees_with_opengl_on_two_tracks_without_and_with_boxes():
    # A process of its own: MuJoCo chooses its OpenGL when it is imported first.
    done = subprocess.run(
        [
            *(sys.executable, SCRIPTS / "bench", "camera"),
            *("--tracks", "2", "--poses", "6", "--rounds", "1", "--json"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    if result["opengl"] is None:
        pytest.skip("no OpenGL without a screen works here (EGL, OSMesa)")
    assert result["poses"] == 6
    assert result["mean_difference"] < 2.5
    assert result["worst_difference"] < 6.0
    assert result["boxes_mean_difference"] < 2.5
    assert result["boxes_worst_difference"] < 6.0
    assert result["correlation"] > 0.99


def test_the_judge_shrinks_pictures_as_pillow_does(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS / "bench")
    opengl_scene = importlib.import_module("opengl_scene")
    image = pytest.importorskip("PIL.Image")
    picture = np.random.default_rng(0).integers(0, 256, (480, 640), np.uint8)

    small = opengl_scene.shrunk(picture.astype(np.float32), 160, 120)

    expected = image.fromarray(picture).resize((160, 120), image.Resampling.BILINEAR)
    difference = small.astype(int) - np.asarray(expected)
    assert np.abs(difference).max() <= 1  # Pillow rounds, the reference's filter cuts off
    assert difference.mean() == pytest.approx(-0.5, abs=0.1)

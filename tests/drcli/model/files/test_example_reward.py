"""The reward function that a new racer starts with."""

import math
import runpy
from pathlib import Path

import pytest

REWARD_FILE = Path(__file__).resolve().parents[4] / "defaults" / "reward_function.py"


@pytest.fixture
def reward():
    return runpy.run_path(str(REWARD_FILE))["reward_function"]


def params(**changes):
    """A car on the centre line, half-way round after 100 steps."""
    return {
        "is_offtrack": False,
        "all_wheels_on_track": True,
        "distance_from_center": 0.0,
        "track_width": 0.76,
        "progress": 50.0,
        "steps": 100.0,
        **changes,
    }


def test_the_centre_line_earns_more_than_the_border(reward):
    assert reward(params()) > reward(params(distance_from_center=0.2))


def test_leaving_the_road_earns_almost_nothing(reward):
    assert reward(params(all_wheels_on_track=False)) == pytest.approx(1e-3)


@pytest.mark.parametrize("progress", [-1.0, 0.0, 100.0])
def test_every_state_earns_a_finite_number(reward, progress):
    earned = reward(params(progress=progress, distance_from_center=5.0, steps=2.0))

    assert isinstance(earned, float)
    assert math.isfinite(earned)
    assert earned >= 0.0

"""Progress round the lap, and its guard against neighbouring stretches."""

import numpy as np
import pytest

from drsim.episode.episode_rules import advance_progress
from drsim.episode.placing import fraction_at, without_jump
from drsim.track.track import Track


def one(previous: float, fraction: float, start: float) -> float:
    return float(advance_progress(np.array([previous]), np.array([fraction]), np.array([start]))[0])


@pytest.mark.parametrize(
    ("previous", "fraction", "start", "progress"),
    [
        (10.0, 0.25, 0.0, 25.0),
        (10.0, 0.85, 0.6, 25.0),
        (50.0, 0.2, 0.6, 60.0),  # over waypoint 0 in the middle of the lap
        (99.5, 0.001, 0.0, 100.0),  # over the finish line
        (99.5, 0.602, 0.6, 100.0),
        (99.5, 0.6, 0.6, 100.0),  # exactly on it
        (0.0, 0.004, 0.0, 0.4),  # the first step of the next lap
        (0.4, 0.998, 0.0, -0.2),  # backwards over the start line
        (-0.2, 0.99, 0.0, -1.0),
        (-1.0, 0.002, 0.0, 0.2),
    ],
)
def test_progress_follows_the_rules_of_the_reference(previous, fraction, start, progress):
    assert one(previous, fraction, start) == pytest.approx(progress)


def test_a_finished_lap_is_exactly_one_hundred():
    assert one(99.9, 0.3071, 0.3) == 100.0


def test_every_car_has_its_own_start():
    progress = advance_progress(np.zeros(2), np.array([0.5, 0.5]), np.array([0.25, 0.4]))

    np.testing.assert_allclose(progress, [25.0, 10.0])


def test_a_progress_leads_back_to_its_place_on_the_lap():
    start = np.array([0.0, 0.7, 0.1])

    place = fraction_at(np.array([25.0, 50.0, -20.0]), start)

    np.testing.assert_allclose(place, [0.25, 0.2, 0.9])


@pytest.fixture
def hairpin() -> Track:
    """Two straights of 6 m only 1 m apart, joined by short ends; borders 0.4 m away."""
    center = np.array([[0, 0], [3, 0], [6, 0], [6, 1], [3, 1], [0, 1], [0, 0]], np.float64)
    out = np.array([[0, -1], [0, -1], [1, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], np.float64)
    return Track("hairpin", center, center - 0.4 * out, center + 0.4 * out, closed=True)


def test_a_car_that_seems_to_jump_to_the_next_stretch_stays_on_its_own(hairpin):
    beyond_the_middle = np.array([2.0, 0.6])
    found_m = float(hairpin.locate(beyond_the_middle[None]).distance_m[0])

    kept_m = without_jump(hairpin, beyond_the_middle, found_m, before_m=1.9)

    assert found_m == pytest.approx(11.0)  # on the way back
    assert kept_m == pytest.approx(2.0, abs=0.03)


def test_a_car_that_drives_over_waypoint_zero_does_not_count_as_a_jump(hairpin):
    point = np.array([0.1, 0.0])

    assert without_jump(hairpin, point, found_m=0.1, before_m=13.9) == 0.1
    assert without_jump(hairpin, point, found_m=13.95, before_m=0.05) == 13.95

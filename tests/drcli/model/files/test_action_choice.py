"""Actions that are generated, needed by a lap, or used. Seed 003-05."""

import math

import pytest

from drcli.base.errors import SettingsError
from drcli.model.files.action_choice import close_share, grid, needed, smoothed, used


def pairs(actions):
    return [(action.steering_angle, action.speed) for action in actions]


def test_the_consoles_own_actions_come_in_its_order():
    made = grid(5, 2, max_angle=30, max_speed=1)

    assert pairs(made) == [
        (angle, speed) for angle in (-30, -15, 0, 15, 30) for speed in (0.5, 1.0)
    ]


def test_single_angles_and_uneven_parts():
    assert pairs(grid(1, 1, max_angle=20, max_speed=2.5)) == [(0.0, 2.5)]
    assert pairs(grid(2, 3, max_angle=25, max_speed=1))[:3] == [(-25, 0.33), (-25, 0.67), (-25, 1)]
    assert len(grid(7, 4, max_angle=30, max_speed=4)) == 28


def test_a_zigzag_becomes_what_it_amounts_to():
    zigzag = [(30.0 * (-1) ** k + 5.0, 2.0) for k in range(60)]

    calm = smoothed(zigzag, 9)

    assert max(abs(angle - 5.0) for angle, _ in calm[5:-5]) < 4.0
    assert smoothed(zigzag, 1) == zigzag


def test_the_middles_of_groups_are_found_with_their_shares():
    groups = {(-20.0, 1.0): 20, (0.0, 3.0): 60, (15.0, 1.5): 20}
    steps = [
        (angle + 0.4 * math.sin(k), speed + 0.02 * math.cos(k))
        for (angle, speed), count in groups.items()
        for k in range(count)
    ]

    found = needed(steps, 3)

    assert pairs(found) == list(groups)
    assert [action.share for action in found] == [0.2, 0.6, 0.2]
    assert needed(steps, None) == found, "three are as few as it takes"


def test_as_few_as_needed_are_close_to_nearly_all_steps():
    steps = [(28 * math.sin(k / 9), 2.0 + 0.8 * math.cos(k / 9)) for k in range(200)]

    found = needed(steps, None)

    assert close_share(steps, found) >= 0.95
    assert close_share(steps, needed(steps, len(found) - 1)) < 0.95
    assert found == needed(steps, None)


@pytest.mark.parametrize("count", [1, 2, 30])
def test_fewer_different_requests_than_actions_are_no_trouble(count):
    found = needed([(10.0, 1.0)] * 5 + [(-10.0, 1.0)] * 5, count)

    assert len(found) == min(count, 2)


def test_discrete_requests_are_counted_as_they_are():
    steps = [(-30.0, 1.0)] * 50 + [(7.3, 1.37)] * 49 + [(0.0, 2.0)]

    found = used(steps, angles=7, speeds=3, least=0.02)

    assert pairs(found) == [(-30.0, 1.0), (7.3, 1.37)]
    assert [action.share for action in found] == [0.5, 0.49]


def test_continuous_requests_are_counted_in_cells():
    steps = [(-30 + 60 * k / 999, 1.0 + 2.0 * ((k * 37) % 1000) / 999) for k in range(1000)]

    found = used(steps, angles=3, speeds=2, least=0.0)

    assert len(found) == 6
    assert sum(action.share for action in found) == pytest.approx(1.0)
    assert [round(action.steering_angle / 20) for action in found] == [-1, -1, 0, 0, 1, 1]
    assert all(abs(action.steering_angle % 20) in (0, 0.5, 19.5) for action in found)


def test_a_share_that_no_action_has_is_refused():
    with pytest.raises(SettingsError, match=r"60\.0%"):
        used([(0.0, 1.0), (1.0, 1.0)], angles=5, speeds=5, least=0.6)

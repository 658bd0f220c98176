"""What the car makes of actions, sensors and frame stacks, with numbers worked by hand."""

import pytest

from drcli.convert.car_rules import (
    action_problems,
    car_actions,
    sensor_problems,
    stack_problems,
    throttle,
)
from drcli.model.files.action_space import ActionSpace


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.25, 0.475), (0.5, 0.8), (0.75, 0.975), (5 / 6, 1.0), (0.9, 1.0), (1.0, 1.0), (0.0, 0.0)],
)
def test_the_throttle_curve_has_the_values_of_the_car(share, expected):
    assert throttle(share * 4.0, 4.0) == pytest.approx(expected)


def test_angles_and_speeds_are_shares_of_the_greatest():
    found = car_actions(ActionSpace(((-20.0, 1.0), (0.0, 4.0), (10.0, 2.0))))

    assert [(a.index, a.steering, a.throttle) for a in found] == [
        (0, -1.0, 0.475),
        (1, 0.0, 1.0),
        (2, 0.5, 0.8),
    ]


def test_ranges_are_shown_at_their_ends_and_between():
    found = car_actions(ActionSpace(low=(-15.0, 1.0), high=(30.0, 2.0)))

    assert {a.index for a in found} == {None}
    assert {(a.steering_deg, a.steering) for a in found} == {
        (-15.0, -0.5),
        (7.5, 0.25),
        (30.0, 1.0),
    }
    shares = [a.throttle for a in found[:5]]
    assert shares == pytest.approx([0.8, 0.90625, 0.975, 1.0, 1.0], abs=1e-4)


def test_speeds_that_are_the_same_throttle_at_one_angle_are_named():
    space = ActionSpace(((0.0, 4.0), (0.0, 3.5), (10.0, 3.4), (10.0, 1.0), (0.0, 2.0)))

    (warning,) = action_problems(space, "m.json")

    assert warning.severity == "warning"
    assert "from 3.33 m/s (83% of the fastest)" in warning.message
    assert "the same there: 4 and 3.5 m/s at 0 deg." in warning.message


def test_speeds_that_are_the_same_throttle_at_other_angles_are_a_note():
    space = ActionSpace(((0.0, 4.0), (10.0, 3.5), (-10.0, 1.0)))

    (note,) = action_problems(space, "m.json")

    assert note.severity == "note"
    assert note.message.endswith("3.5, 4 m/s.")


def test_speeds_that_differ_on_the_car_are_no_problem():
    assert list(action_problems(ActionSpace(((-30.0, 1.0), (30.0, 2.0))), "m.json")) == []


@pytest.mark.parametrize(
    ("low", "high", "severity"),
    [
        ((-30.0, 1.0), (20.0, 2.0), "error"),
        ((-30.0, 1.0), (-10.0, 2.0), "error"),
        ((-30.0, 1.0), (30.0, 2.0), "note"),
        ((-10.0, 1.0), (30.0, 2.0), "note"),
        ((-30.0, 1.9), (30.0, 2.0), "warning"),
        ((-30.0, -2.0), (30.0, -1.0), "error"),
    ],
)
def test_ranges_that_the_car_cannot_drive_are_errors(low, high, severity):
    first = next(iter(action_problems(ActionSpace(low=low, high=high), "m.json")))

    assert first.severity == severity


def test_unequal_steering_is_explained_with_the_angles():
    space = ActionSpace(low=(-30.0, 1.0), high=(20.0, 2.0))

    problem = next(iter(action_problems(space, "m.json")))

    assert problem.rule == "V-31"
    assert "from -30 to 20" in problem.message
    assert problem.remedy == "Train with a low of -20 or more, or a high of 30."


@pytest.mark.parametrize(
    ("values", "text"),
    [
        (((0.0, 1.0), (0.0, 2.0)), "no action steers"),
        (((10.0, 0.0), (-10.0, 0.0)), "never drives forward"),
        (((10.0, -1.0), (-10.0, -2.0)), "never drives forward"),
    ],
)
def test_actions_that_lead_nowhere_are_named(values, text):
    assert text in " ".join(p.message for p in action_problems(ActionSpace(values), "m.json"))


@pytest.mark.parametrize(
    ("sensors", "found"),
    [
        (["FRONT_FACING_CAMERA"], []),
        (["observation"], []),
        (["STEREO_CAMERAS"], ["warning"]),
        (["FRONT_FACING_CAMERA", "SECTOR_LIDAR"], ["warning"]),
        (["FRONT_FACING_CAMERA", "LIDAR"], ["warning", "warning"]),
        (["FRONT_FACING_CAMERA", "DISCRETIZED_SECTOR_LIDAR"], ["error", "warning"]),
    ],
)
def test_sensors_that_the_car_reads_otherwise_are_named(sensors, found):
    assert [problem.severity for problem in sensor_problems(sensors, "m.json")] == found


def test_a_stack_of_frames_is_an_error():
    assert list(stack_problems(1, "h.json")) == []
    (error,) = stack_problems(4, "h.json")
    assert error.severity == "error"
    assert "stack_size=4" in error.message

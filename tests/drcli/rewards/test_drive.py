"""The scripted drive: whole laps, mishaps, and every parameter with its values."""

import math
import re
from pathlib import Path

import pytest

from drcli.base.errors import SettingsError
from drcli.rewards.check import _parameters
from drcli.rewards.course import (
    FAST,
    LATE,
    LEAVING,
    RAMMING,
    STANDING,
    STEADY,
    TURNED,
    WEAVING,
)
from drcli.rewards.sandbox.run_sandbox import SandboxResult
from drcli.rewards.sandbox.sample_calls import sample_params
from drcli.rewards.scripted_drive import drive, nearest_action
from drcli.rewards.tried_reward import TriedReward
from drsim.car.actions import ContinuousActions, DiscreteActions
from drsim.track.worlds import load_track

ALONG = (STEADY, FAST, WEAVING)
ALWAYS_THE_SAME = {"track_length"}


def ranges(course):
    parameters = _parameters(TriedReward("", course.course, SandboxResult(), frozenset(), []))
    return {found.name: (found.least, found.greatest) for found in parameters}


def test_slow_fast_and_weaving_drivers_complete_their_laps(course):
    trips = [course.drive.trip(driver) for driver in ALONG]

    assert all(trip.whole for trip in trips)
    assert trips[1].seconds < 0.8 * trips[0].seconds
    assert not any(call["is_offtrack"] or call["is_crashed"] for call in trips[0].calls)


def test_the_drivers_drive_the_car_of_the_settings_and_complete_their_laps(course, settings_of):
    drive_ = drive(settings_of(DR_SIM_CAR="2022").race)

    slower = [drive_.trip(driver).seconds / course.drive.trip(driver).seconds for driver in ALONG]
    assert all(drive_.trip(driver).whole for driver in ALONG)
    assert all(ratio > 1.03 for ratio in slower)


@pytest.mark.parametrize(
    "actions",
    [
        DiscreteActions([(-30.0, 1.0), (-10.0, 2.0), (0.0, 3.5), (10.0, 2.0), (30.0, 1.0)]),
        ContinuousActions((-20.0, 15.0), (0.8, 1.4)),
    ],
)
def test_drivers_ask_for_nothing_but_the_actions_of_the_model(settings_of, actions):
    drive_ = drive(settings_of().race, actions)

    asked = {
        (call["steering_angle"], call["speed"]) for trip in drive_.trips for call in trip.calls
    }
    assert all(nearest_action(actions, *each) == each for each in asked)
    fastest = max(speed for _, speed in asked)
    assert fastest == drive_.trip(FAST).driver.speed_mps
    assert f"{fastest:g} m/s" in drive_.trip(FAST).driver.about
    assert drive_.trip(FAST).whole


def test_the_driver_that_leaves_ends_off_the_road(course):
    trip = course.drive.trip(LEAVING)

    assert trip.end == "off_track"
    assert trip.calls[-1]["is_offtrack"]
    assert not trip.calls[0]["is_offtrack"]


def test_the_driver_that_stands_hardly_moves(course):
    trip = course.drive.trip(STANDING)

    assert {call["speed"] for call in trip.calls} == {0.0}
    assert trip.progress < 5.0


def test_the_driver_that_rams_ends_in_a_crash(obstacle_course):
    trip = obstacle_course.drive.trip(RAMMING)

    assert trip.end == "crashed"
    assert trip.calls[-1]["is_crashed"]


def test_both_directions_are_driven_where_training_turns_round(obstacle_course):
    directions = {
        trip.driver: {call["is_reversed"] for call in trip.calls}
        for trip in obstacle_course.drive.trips
    }

    assert directions[TURNED] == {True}
    assert directions[STEADY] == {False}


def test_laps_are_whole_although_boxes_stand_in_the_way(obstacle_course):
    assert obstacle_course.drive.trip(STEADY).whole
    assert obstacle_course.drive.trip(FAST).whole


def test_every_parameter_takes_on_its_values_with_objects_on_the_road(obstacle_course):
    found = ranges(obstacle_course)

    assert len(found) == 27
    still = {"objects_speed", "objects_heading"}  # boxes neither move nor tell their heading
    constant = {name for name, (least, greatest) in found.items() if least == greatest}
    assert constant == ALWAYS_THE_SAME | still


def test_every_parameter_of_a_car_takes_on_its_values_in_a_time_trial(course):
    found = ranges(course)

    assert len(found) == 27
    constant = {name for name, (least, greatest) in found.items() if least == greatest}
    assert {name for name in constant if "object" not in name} == {
        *ALWAYS_THE_SAME,
        "is_crashed",
        "is_reversed",
    }
    assert found["progress"][1] == 100.0
    assert found["steps"][0] == 2.0
    assert found["objects_location"] == (None, None)


def test_places_of_the_grid_are_told_like_those_of_a_drive(course):
    grid, driven = course.grid, course.drive.trip(STEADY).calls[0]
    middle = grid.calls[grid.off.shape[1] * (len(grid.off) // 2) :][: grid.off.shape[1]]

    assert {key: type(value) for key, value in middle[0].items()} == {
        key: type(value) for key, value in driven.items()
    }
    assert all(0.0 < call["distance_from_center"] < 0.02 for call in middle)
    assert grid.off[[0, -1]].all()
    assert not grid.off[2:-2].any()


def test_a_function_that_divides_by_what_is_never_zero_has_a_value_at_every_place(course):
    """No car is exactly on the centre line, or parallel to it."""
    waypoints = course.drive.waypoints()

    def turned_deg(call):
        before, after = call["closest_waypoints"]
        (x, y), (next_x, next_y) = (waypoints[call["is_reversed"]][k] for k in (before, after))
        return call["heading"] - math.degrees(math.atan2(next_y - y, next_x - x))

    assert min(call["distance_from_center"] for call in course.grid.calls) > 1e-3
    assert min(abs(turned_deg(call)) for call in course.grid.calls) > 1e-3


def test_a_race_of_two_models_is_refused_with_the_setting_to_change(settings_of):
    settings = settings_of(DR_RACE_TYPE="HEAD_TO_MODEL", DR_EVAL_OPP_S3_MODEL_PREFIX="other")

    with pytest.raises(SettingsError, match="HEAD_TO_MODEL") as refused:
        drive(settings.race)

    assert "DR_RACE_TYPE" in refused.value.remedy


def test_the_page_about_rewards_explains_exactly_the_parameters_there_are(course):
    page = (Path(__file__).resolve().parents[3] / "docs" / "reward-functions.md").read_text("utf-8")
    table = page.partition("\n## Parameters\n")[2].partition("\n## ")[0]

    explained = {
        name
        for row in table.splitlines()
        if row.startswith("| `")
        for name in re.findall(r"`(\w+)`", row.split("|")[1])
    }

    assert explained == set(ranges(course))


def test_the_call_late_in_a_long_episode_is_a_step_after_the_one_before():
    before, late = sample_params(load_track("bean"))[LATE - 1 : LATE + 1]

    assert late["steps"] - before["steps"] == 1
    assert late["sim_time"] > before["sim_time"] > 60.0
    assert 0.0 < late["progress"] - before["progress"] < 1.0

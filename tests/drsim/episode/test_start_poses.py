"""Starts beside the centre line and at an angle to it (003-18)."""

import numpy as np
import pytest

from drsim.car.car import WHEELS_M
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.placing import offset_of, start_pose
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.track.worlds import load_track

TRACK = load_track("reinvent_base")
PLACES = np.linspace(0.0, 0.95, 12)
DIRECTIONS = pytest.mark.parametrize("track", [TRACK, TRACK.reversed()], ids=["given", "reversed"])


def left_of_centre_m(track, fraction, pose):
    """How far a point is to the left of the centre line at a fraction of the lap."""
    x, y, yaw = track.pose_at(np.array([fraction * track.length_m]))[0]
    return (pose[0] - x) * -np.sin(yaw) + (pose[1] - y) * np.cos(yaw)


@DIRECTIONS
def test_left_is_on_the_left_of_the_driving_direction_and_right_on_the_right(track):
    for fraction in PLACES:
        left, right = (offset_of(track, fraction, side) for side in ("left", "right"))

        assert right < -0.1 < 0.1 < left
        assert offset_of(track, fraction, "centre") == 0.0


@DIRECTIONS
def test_a_start_is_where_it_was_asked_for(track):
    for fraction in PLACES:
        found = start_pose(track, fraction, 0.15, -20.0)

        assert (found.offset_m, found.on_road) == (0.15, True)
        assert left_of_centre_m(track, fraction, found.pose) == pytest.approx(0.15)
        yaw = track.pose_at(np.array([fraction * track.length_m]))[0, 2]
        assert found.pose[2] - yaw == pytest.approx(np.radians(-20.0))


@pytest.mark.parametrize("offset_m", [5.0, -5.0, 0.37])
@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 180.0])
def test_no_wheel_starts_off_the_road(offset_m, angle_deg):
    for fraction in PLACES:
        found = start_pose(TRACK, fraction, offset_m, angle_deg)

        x, y, yaw = found.pose
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        assert found.on_road
        assert TRACK.on_road([x, y] + WHEELS_M[:, :2] @ turn.T).all()
        # A neighbouring stretch of the road, some metres away, is not this one.
        assert 0.1 < found.offset_m * np.sign(offset_m) <= min(abs(offset_m), 0.6)


def test_a_road_that_is_narrower_than_the_car_starts_it_on_the_centre_line():
    narrow = load_track("reinvent_base")
    thin = type(narrow)(
        "thin",
        narrow.center.copy(),
        narrow.center + (narrow.inner - narrow.center) * 0.1,
        narrow.center + (narrow.outer - narrow.center) * 0.1,
        closed=True,
    )

    found = start_pose(thin, 0.3, 0.2, 0.0)

    assert (found.offset_m, found.on_road) == (0.0, False)


@pytest.fixture(scope="module")
def simulation():
    built = Simulation(
        TRACK,
        num_cars=3,
        reward_function=centre_line_reward,
        rules=EpisodeRules(max_lap_steps=8, max_resets=9),
        num_threads=1,
    )
    yield built
    built.close()


def test_cars_of_both_directions_start_beside_the_line_and_turned(simulation):
    cars, fractions = np.arange(3), np.array([0.1, 0.4, 0.4])
    offsets, angles = np.array([0.0, 0.2, -0.2]), np.array([10.0, 0.0, -15.0])
    backward = np.array([False, False, True])

    simulation.reset(cars, fractions, reverse=backward, offset_m=offsets, angle_deg=angles)

    poses = simulation.poses
    for car in range(3):
        track = TRACK.reversed() if backward[car] else TRACK
        yaw = track.pose_at(fractions[car : car + 1] * track.length_m)[0, 2]
        turned = np.degrees(poses[car, 2] - yaw + np.pi) % 360.0 - 180.0
        assert left_of_centre_m(track, fractions[car], poses[car]) == pytest.approx(
            offsets[car], abs=0.002
        )
        assert turned == pytest.approx(angles[car], abs=0.1)


def test_the_next_episode_starts_on_the_line_again(simulation):
    simulation.reset(np.array([0]), np.array([0.3]), offset_m=np.array([0.2]))

    row = simulation.reset(np.array([0]), np.array([0.3]))

    assert abs(row.from_center_m[0]) < 0.02

"""What a teacher drives by: the features of a car, its road, its objects and its episode."""

import numpy as np
import pytest

from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.episode.teacher_features import EPISODE_DIMS, TEACHER_DIMS
from drsim.race.race import TIME_TRIAL, BotRules, ObstacleRules, Race
from drsim.track.worlds import load_track

BOTH = np.arange(2)
NONE = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
OBJECTS = slice(32, 68)


@pytest.fixture(scope="module")
def track():
    return load_track("reinvent_base")


@pytest.fixture
def simulate(track):
    """Makes simulations of two cars, and closes them."""
    made = []

    def make(race: Race = TIME_TRIAL) -> Simulation:
        made.append(
            Simulation(
                track, num_cars=2, reward_function=centre_line_reward, num_threads=1, race=race
            )
        )
        return made[-1]

    yield make
    for simulation in made:
        simulation.close()


def objects(told):
    return told[:, OBJECTS].reshape(len(told), 4, 9)


def test_a_car_at_rest_on_a_free_straight_sees_the_line_before_it(simulate, track):
    sim = simulate()
    sim.reset(BOTH, np.array([0.0, 0.5]))

    told = sim.teacher_state(BOTH)

    assert told.shape == (2, TEACHER_DIMS)
    np.testing.assert_allclose(told[:, 0], 0.0, atol=0.1)  # offset in half widths
    np.testing.assert_allclose(told[:, 1], 0.38, atol=0.02)  # half the width in metres
    np.testing.assert_allclose(told[:, 3], 1.0, atol=0.05)  # cosine of the heading
    np.testing.assert_allclose(told[:, 4:10], 0.0, atol=1e-6)  # nothing moves or was asked for
    np.testing.assert_allclose(told[:, 12:14], [[1.0, 0.0]] * 2, atol=0.1)
    np.testing.assert_allclose(objects(told), np.tile(NONE, (2, 4, 1)))
    np.testing.assert_allclose(told[:, -EPISODE_DIMS:], [[0.0, 1 / 300]] * 2, atol=0.01)


def test_motion_and_the_last_request_are_told_until_the_next_start(simulate):
    sim = simulate()
    sim.reset(BOTH, np.array([0.0, 0.5]))
    for _ in range(12):
        sim.step(np.array([15.0, -15.0]), np.array([2.0, 1.0]))
    speeds = sim.speeds_mps

    told = sim.teacher_state(BOTH)
    sim.reset(BOTH[:1], np.zeros(1))
    after = sim.teacher_state(BOTH)

    np.testing.assert_allclose(np.hypot(4.0 * told[:, 4], told[:, 5]), speeds, rtol=1e-5)
    np.testing.assert_allclose(told[:, 8:10], [[0.5, 0.5], [-0.5, 0.25]])
    np.testing.assert_allclose(told[:, 7], [0.5, -0.5], atol=0.1)  # the wheels
    assert told[0, 6] > 0.1  # the yaw rate
    assert told[1, 6] < -0.1
    np.testing.assert_allclose(after[0, 4:10], 0.0, atol=1e-6)
    np.testing.assert_array_equal(after[1], told[1])


def test_a_car_that_was_put_back_on_the_road_has_no_request_under_way(track):
    rules = EpisodeRules(max_resets=1)
    sim = Simulation(
        track, num_cars=2, reward_function=centre_line_reward, num_threads=1, rules=rules
    )
    sim.reset(BOTH, np.array([0.0, 0.5]))
    resets = 0
    while resets == 0:
        resets = sim.step(np.array([30.0, 0.0]), np.array([2.0, 0.5])).resets[0]

    told = sim.teacher_state(BOTH)
    sim.close()

    np.testing.assert_array_equal(told[0, 4:10], 0.0)
    np.testing.assert_allclose(told[1, 8:10], [0.0, 0.125])


def test_an_object_is_told_in_the_frame_of_the_car_and_by_the_room_beside_it(simulate, track):
    # The inner lane is on the left of this track, which runs counter-clockwise.
    sim = simulate(Race(obstacles=ObstacleRules(positions=((0.06, 1), (0.6, -1)))))
    sim.reset(BOTH, np.array([0.0, 0.54]))

    told = objects(sim.teacher_state(BOTH))

    there, ahead_m, forward_m, left_m, aside_m, left_room_m, right_room_m, slower, _ = told[0, 0]
    assert there == 1.0
    np.testing.assert_allclose(6.0 * ahead_m, 0.06 * track.length_m - 0.14, atol=0.05)
    np.testing.assert_allclose(6.0 * forward_m, 6.0 * ahead_m, atol=0.05)
    np.testing.assert_allclose(2.0 * left_m, aside_m, atol=0.05)
    np.testing.assert_allclose(aside_m, 0.19, atol=0.02)
    # A box is 0.4 m wide, a car 0.196 m, half the road 0.38 m.
    np.testing.assert_allclose(left_room_m, 0.38 - 0.19 - 0.2 - 0.196, atol=0.02)
    np.testing.assert_allclose(right_room_m, 0.38 + 0.19 - 0.2 - 0.196, atol=0.02)
    assert slower == 0.0
    assert told[1, 0, 4] == pytest.approx(-0.19, abs=0.03)
    np.testing.assert_allclose(told[:, 1:], np.tile(NONE, (2, 3, 1)))


def test_an_object_stays_in_sight_until_the_whole_car_has_passed_it(simulate, track):
    sim = simulate(Race(obstacles=ObstacleRules(positions=((0.5, 1),))))
    length_m = track.length_m

    sim.reset(BOTH, 0.5 + (np.array([0.5, 1.1]) - 0.14) / length_m)
    told = objects(sim.teacher_state(BOTH))

    assert told[:, 0, 0].tolist() == [1.0, 0.0]
    assert told[0, 0, 1] == pytest.approx(-0.5 / 6.0, abs=0.01)


def test_left_is_left_in_both_directions(simulate):
    sim = simulate(Race(obstacles=ObstacleRules(positions=((0.5, 1),))))
    sim.reset(BOTH, np.array([0.45, 0.45]), reverse=np.array([False, True]))

    told = objects(sim.teacher_state(BOTH))

    np.testing.assert_allclose(told[1, 0, 4], -told[0, 0, 4], atol=0.02)
    np.testing.assert_allclose(told[1, 0, [5, 6]], told[0, 0, [6, 5]], atol=0.02)


def test_bots_are_told_with_their_speed_against_the_car(simulate):
    sim = simulate(Race(bots=BotRules(count=2, speed_mps=0.8)))
    sim.reset(BOTH, np.array([0.0, 0.0]))
    standing = objects(sim.teacher_state(BOTH))
    for _ in range(15):
        sim.step(np.zeros(2), np.array([2.0, 1.0]))

    told = objects(sim.teacher_state(BOTH))

    np.testing.assert_allclose(standing[:, 0, 7], 0.8 / 4.0, atol=0.01)
    np.testing.assert_allclose(told[:, 0, 7], (0.8 - sim.speeds_mps) / 4.0, atol=0.01)
    np.testing.assert_allclose(told[:, 0, 8], 0.0, atol=0.05)  # they keep to their lane
    assert told[0, 0, 1] < told[1, 0, 1] < standing[1, 0, 1]


def test_of_two_racers_each_is_told_the_speed_of_the_other(simulate):
    sim = simulate(Race(racers=2))
    sim.reset(BOTH, np.array([0.0, 0.0]))
    for _ in range(10):
        sim.step(np.zeros(2), np.array([1.0, 2.0]))

    told = objects(sim.teacher_state(BOTH))

    assert told[:, 0, 0].tolist() == [1.0, 1.0]
    np.testing.assert_allclose(told[0, 0, 7], -told[1, 0, 7], atol=0.02)
    assert told[0, 0, 1] * told[1, 0, 1] < 0.0  # one is behind

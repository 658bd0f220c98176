"""What a critic may know: the features of a car on the lap."""

import numpy as np
import pytest

from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.episode.teacher_features import PRIVILEGED_DIMS
from drsim.race.race import ObstacleRules, Race
from drsim.track.worlds import load_track


@pytest.fixture(scope="module")
def track():
    return load_track("reinvent_base")


def simulation(track, race: Race | None = None) -> Simulation:
    extra = {} if race is None else {"race": race}
    return Simulation(track, num_cars=2, reward_function=centre_line_reward, num_threads=1, **extra)


def test_a_car_on_the_line_looks_along_it(track):
    sim = simulation(track)
    sim.reset(np.arange(2), np.array([0.0, 0.5]))

    told = sim.privileged(np.arange(2))
    sim.close()

    assert told.shape == (2, PRIVILEGED_DIMS)
    np.testing.assert_allclose(told[:, 0], 0.0, atol=0.1)  # offset in half widths
    np.testing.assert_allclose(told[:, 2], 1.0, atol=0.05)  # cosine of the heading
    np.testing.assert_allclose(told[:, 3], 0.0, atol=1e-6)  # at rest
    np.testing.assert_allclose(told[:, -4:], [[1.0, 0.0, 1.0, 0.0]] * 2)  # no objects


def test_the_same_place_driven_the_other_way_is_another_place_of_the_lap(track):
    sim = simulation(track)
    sim.reset(np.arange(2), np.array([0.25, 0.25]), reverse=np.array([False, True]))

    told = sim.privileged(np.arange(2))
    sim.close()

    np.testing.assert_allclose(told[:, 2], 1.0, atol=0.05)
    assert not np.allclose(told[0], told[1])


def test_objects_ahead_are_told_by_distance_and_side(track):
    race = Race(obstacles=ObstacleRules(count=2, positions=((0.1, 1), (0.6, -1))))
    sim = simulation(track, race)
    sim.reset(np.arange(2), np.array([0.0, 0.5]))

    told = sim.privileged(np.arange(2))
    sim.close()

    near = 0.1 * track.length_m / 4.0
    np.testing.assert_allclose(told[:, -4], near, atol=0.05)
    assert np.sign(told[0, -3]) == -np.sign(told[1, -3]) != 0.0
    np.testing.assert_allclose(told[:, -2], 1.0)  # the other one is out of reach

"""Cars whose physics fails end their episode, and only that."""

import numpy as np
import pytest

from drsim.episode.episode_rules import EpisodeRules, Status
from drsim.episode.placing import mark_unstable
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.track.worlds import load_track


@pytest.fixture
def simulation(tmp_path, monkeypatch):
    """Three cars; the physics engine writes its own log into the working folder."""
    monkeypatch.chdir(tmp_path)
    seen = []

    def reward(params):
        seen.append(params)
        return centre_line_reward(params)

    simulation = Simulation(
        load_track("reinvent_base"), num_cars=3, reward_function=reward, num_threads=1
    )
    simulation.seen = seen
    simulation.reset(np.arange(3), np.array([0.0, 0.3, 0.6]))
    simulation.before = simulation.step(np.zeros(3), np.ones(3))
    yield simulation
    simulation.close()


def break_position(simulation):
    simulation._cars._physics.qpos[1, 0] = np.nan


def break_heading(simulation):
    simulation._cars._physics.qpos[1, 3:7] = np.nan


def break_speed(simulation):
    simulation._cars._physics.qvel[1, 0] = 1e12


def let_it_fly(simulation):
    simulation._cars._physics.qvel[1, 2] = 50.0


@pytest.mark.parametrize("fail", [break_position, break_heading, break_speed, let_it_fly])
def test_the_episode_ends_off_track_where_the_car_was(simulation, fail):
    before = simulation.before
    fail(simulation)

    row = simulation.step(np.zeros(3), np.ones(3))

    assert simulation.unstable.tolist() == [False, True, False]
    assert row.done.tolist() == [False, True, False]
    assert Status(int(row.status[1])) is Status.OFF_TRACK
    assert (row.x[1], row.y[1]) == pytest.approx((before.x[1], before.y[1]), abs=0.05)
    assert row.progress[1] == pytest.approx(before.progress[1], abs=0.5)
    assert np.isfinite(row.reward).all()
    numbers = [v for p in simulation.seen for v in p.values() if isinstance(v, float)]
    assert np.isfinite(numbers).all()


def test_the_car_drives_its_next_episode_as_any_other(simulation):
    break_position(simulation)
    simulation.step(np.zeros(3), np.ones(3))

    simulation.reset(np.array([1]), np.array([0.3]))
    row = simulation.step(np.zeros(3), np.ones(3))

    assert not simulation.unstable.any()
    assert row.x[1] == simulation.before.x[1]


def test_in_an_evaluation_the_car_is_put_back_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=1,
        reward_function=centre_line_reward,
        rules=EpisodeRules.evaluation(max_resets=3),
        num_threads=1,
    )
    simulation.reset(np.array([0]), np.array([0.3]))
    simulation.step(np.zeros(1), np.ones(1))
    simulation._cars._physics.qpos[0, 0] = np.nan

    row = simulation.step(np.zeros(1), np.ones(1))

    assert not row.done[0]
    assert row.resets[0] == 1
    for _ in range(40):
        row = simulation.step(np.zeros(1), np.ones(1))
    assert np.isfinite(row.progress[0])
    simulation.close()


def test_the_fastest_car_is_stable():
    xy, lens = np.array([[0.28, 0.0], [1.2, 0.0]]), np.full((2, 3), 0.13)
    unstable = np.zeros(2, np.bool_)

    assert mark_unstable(xy, np.zeros((2, 2)), np.zeros(2), lens, unstable)

    assert unstable.tolist() == [False, True]


def test_a_car_that_drives_in_circles_for_a_reward_ends_at_the_step_limit():
    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=1,
        reward_function=lambda params: 1.0,
        rules=EpisodeRules(max_steps=60, patience_steps=1000),
        num_threads=1,
    )
    simulation.reset(np.array([0]), np.array([0.0]))
    rows = []
    while not rows or not rows[-1].done[0]:
        assert len(rows) < 100
        rows.append(simulation.step(np.array([30.0]), np.array([0.2])))

    assert len(rows) <= 60
    simulation.close()

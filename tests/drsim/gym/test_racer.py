"""The Gymnasium faces: their contract, their action spaces, and when episodes end."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from drsim.car.actions import ContinuousActions, DiscreteActions
from drsim.episode.episode_rules import EpisodeRules, Status
from drsim.errors import TrackError
from drsim.gym.racer import RacerEnv
from drsim.gym.racer_vector import RacerVectorEnv
from drsim.track.worlds import load_track


@pytest.fixture(scope="module")
def track():
    return load_track("reinvent_base")


@pytest.mark.parametrize(
    "actions", [DiscreteActions([(0.0, 1.0), (20.0, 1.5)]), ContinuousActions()]
)
def test_the_environment_keeps_gymnasiums_contract(track, actions):
    env = RacerEnv(track, actions=actions, render_mode="rgb_array")

    with warnings.catch_warnings():
        # check_env suggests gym.make for environments with a spec; ours is built directly.
        warnings.filterwarnings("ignore", message=".*not created with a spec.*")
        warnings.filterwarnings("ignore", message=".*Not able to test alternative render modes.*")
        check_env(env)

    env.close()


def test_discrete_actions_are_positions_in_the_list():
    actions = DiscreteActions([(-30.0, 1.0), (15.0, 2.5)])

    steering_deg, speed_mps = actions.requests(np.array([1, 0, 1]))

    assert actions.space() == gym.spaces.Discrete(2)
    assert steering_deg.tolist() == [15.0, -30.0, 15.0]
    assert speed_mps.tolist() == [2.5, 1.0, 2.5]


def test_continuous_actions_are_clipped_and_mapped_linearly():
    actions = ContinuousActions(steering_deg=(-20.0, 20.0), speed_mps=(1.0, 2.0))

    steering_deg, speed_mps = actions.requests(np.array([[-1.0, -1.0], [0.5, 0.0], [3.0, 9.0]]))

    np.testing.assert_allclose(steering_deg, [-20.0, 10.0, 20.0])
    np.testing.assert_allclose(speed_mps, [1.0, 1.5, 2.0])


def test_the_seed_of_reset_decides_where_an_episode_starts(track):
    env = RacerEnv(track)

    first, _ = env.reset(seed=5)
    again, _ = env.reset(seed=5)
    elsewhere, _ = env.reset()

    np.testing.assert_array_equal(first, again)
    assert (first != elsewhere).any()


def test_a_start_may_be_fixed_or_asked_for(track):
    env = RacerEnv(track, start=0.0)

    _, fixed = env.reset(seed=1)
    _, asked = env.reset(options={"start": 0.5})

    np.testing.assert_allclose([fixed["x"], fixed["y"]], track.waypoints[0], atol=0.2)
    assert np.hypot(asked["x"] - fixed["x"], asked["y"] - fixed["y"]) > 2.0
    assert fixed["status"] == "prepare"


def test_leaving_the_track_terminates_and_the_step_limit_truncates(track):
    off = RacerEnv(track, start=0.0)
    cut = RacerEnv(track, start=0.0, rules=EpisodeRules(max_steps=3))
    off.reset()
    cut.reset()

    ends = []
    for env in (off, cut):
        for _ in range(100):
            _, reward, terminated, truncated, info = env.step(9)
            assert type(reward) is float
            if terminated or truncated:
                ends.append((terminated, truncated, info["status"]))
                break

    assert ends == [(True, False, "off_track"), (False, True, "immobilized")]


def test_rendering_shows_the_camera_in_three_channels(track):
    env = RacerEnv(track, render_mode="rgb_array")
    frame, _ = env.reset(seed=0)

    picture = env.render()

    assert picture.shape == (120, 160, 3)
    np.testing.assert_array_equal(picture[..., 2], frame[..., 0])


def test_an_unknown_world_is_refused():
    with pytest.raises(TrackError):
        RacerEnv("no_such_world")


def test_many_cars_see_batches_of_the_declared_spaces(track):
    env = RacerVectorEnv(3, track, actions=ContinuousActions())

    frames, _ = env.reset(seed=0)
    frames_after, reward, terminated, truncated, info = env.step(env.action_space.sample())

    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert env.observation_space.contains(frames)
    assert env.observation_space.contains(frames_after)
    assert reward.shape == terminated.shape == truncated.shape == info["progress"].shape == (3,)
    assert (frames != frames_after).any()
    env.close()


def test_a_car_whose_episode_ended_begins_the_next_one_in_the_step_that_follows(track):
    env = RacerVectorEnv(2, track, start=0.0, rules=EpisodeRules(max_steps=3))
    env.reset(seed=0)

    rows = [env.step(np.array([4, 5])) for _ in range(4)]

    truncations = [row[3].tolist() for row in rows]
    assert truncations == [[False] * 2, [True] * 2, [False] * 2, [False] * 2]
    assert rows[2][1].tolist() == [0.0, 0.0]
    assert [row[4]["steps"].tolist() for row in rows] == [[2, 2], [3, 3], [1, 1], [2, 2]]
    assert rows[2][4]["status"].tolist() == [Status.PREPARE] * 2
    env.close()


def test_one_car_among_many_sees_what_it_would_see_alone(track):
    alone = RacerEnv(track, start=0.25)
    many = RacerVectorEnv(4, track, start=0.25)
    alone.reset(seed=0)
    many.reset(seed=0)

    for action in (5, 7, 3, 5):
        frame, reward, *_ = alone.step(action)
        frames, rewards, *_ = many.step(np.array([0, 9, action, 5]))

    np.testing.assert_array_equal(frames[2], frame)
    assert rewards[2] == reward
    many.close()

"""The shipped reward functions: they run on every track and in every race. Seeds 003-04, 001-36."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drcli.config.presets import model_file, presets_folder
from drcli.rewards.sandbox.sample_calls import sample_params
from drsim.episode.load_reward import load_reward_function
from drsim.race.race import TIME_TRIAL, BotRules, ObstacleRules, Race
from drsim.track.worlds import known_worlds, load_track

SHARED_TRACKS = Path(__file__).parents[4] / "shared" / "tracks"

EXAMPLES = sorted(
    {
        *model_file("rewards").glob("*/reward_function.py"),
        *presets_folder().glob("*/reward_function.py"),
        model_file("reward_function.py"),
    }
)

RACES = {
    "alone": TIME_TRIAL,
    "boxes": Race(obstacles=ObstacleRules(count=2)),
    "bots": Race(bots=BotRules(count=1)),
}

Reward = Callable[[dict[str, Any]], float]


def reward(name: str) -> Reward:
    return load_reward_function(model_file(f"rewards/{name}/reward_function.py"))


def params(**changes: Any) -> dict[str, Any]:
    """A car in the middle of a road that is 8 m long, straight, then 4 m of bend."""
    straight = [(0.25 * k, 0.0) for k in range(33)]
    bend = [(8.0 + 0.2 * k, 0.05 * k * k) for k in range(1, 21)]
    usual = {
        "all_wheels_on_track": True,
        "is_offtrack": False,
        "is_crashed": False,
        "distance_from_center": 0.0,
        "track_width": 1.0,
        "track_length": 20.0,
        "progress": 10.0,
        "steps": 10.0,
        "closest_waypoints": [4, 5],
        "waypoints": straight + bend,
        "steering_angle": 0.0,
        "heading": 0.0,
        "speed": 1.0,
    }
    return usual | changes


@pytest.mark.parametrize("race", RACES)
@pytest.mark.parametrize("world", sorted(known_worlds()))
def test_every_example_runs_on_every_built_in_track(world, race):
    track = load_track(world)
    try:
        calls = sample_params(track, RACES[race])
    except ValueError:
        pytest.skip("There is no room for the objects on this track.")

    for path in EXAMPLES:
        function = load_reward_function(path)
        rewards = [function(call) for call in calls]
        assert all(isinstance(value, float) and 0 < value < 1000 for value in rewards), path
        assert len(set(rewards)) > 1, path


def test_every_example_runs_on_every_community_track():
    if not SHARED_TRACKS.is_dir():
        pytest.skip("The routes of the community tracks are not here.")
    functions = [load_reward_function(path) for path in EXAMPLES]

    names = {route.stem for route in SHARED_TRACKS.glob("*.npy")}
    # A name with a direction is the same road as the one without.
    roads = {name for name in names if name.removesuffix("_ccw").removesuffix("_cw") == name}
    others = {name for name in names - roads if name.rpartition("_")[0] not in roads}
    for route in sorted(SHARED_TRACKS / f"{name}.npy" for name in roads | others):
        calls = sample_params(load_track(str(route)))[::4]
        for function in functions:
            assert all(0 < function(call) < 1000 for call in calls), route.name


def test_every_folder_of_examples_has_the_three_files():
    for path in model_file("rewards").glob("*/reward_function.py"):
        files = {file.name for file in path.parent.iterdir() if file.is_file()}
        assert files == {"reward_function.py", "hyperparameters.json", "model_metadata.json"}


def test_a_milestone_pays_once_and_more_the_sooner_it_is_reached():
    """003-04."""
    paid = {}
    for steps in (15.0, 30.0):
        function = reward("milestones")
        function(params(steps=2.0, progress=1.0, closest_waypoints=[0, 1]))
        before = function(params(steps=8.0, progress=5.0, closest_waypoints=[3, 4]))
        at = function(params(steps=steps, progress=12.0, closest_waypoints=[6, 7]))
        after = function(params(steps=steps + 1, progress=12.5, closest_waypoints=[6, 7]))
        assert before == after == pytest.approx(0.5)
        paid[steps] = at - after

    assert paid[15.0] == pytest.approx(2 * paid[30.0], rel=0.01)
    assert paid[30.0] > 5.0


def test_a_milestone_pays_nothing_off_the_road_backwards_or_after_the_start():
    function = reward("milestones")
    first = function(params(steps=2.0, progress=0.5, closest_waypoints=[30, 31]))
    off = function(
        params(steps=9.0, progress=12.0, closest_waypoints=[6, 7], all_wheels_on_track=False)
    )
    back = function(params(steps=12.0, progress=3.0, closest_waypoints=[1, 2]))
    begun = function(params(steps=2.0, progress=0.5, closest_waypoints=[45, 46]))

    assert first == back == begun == pytest.approx(0.5)
    assert off < 0.01


def test_steering_costs_on_a_straight_and_not_in_a_bend():
    """003-04."""
    function = reward("straights")
    on_straight = {angle: function(params(steering_angle=angle)) for angle in (0, 4, -12, 20, 30)}
    in_bend = {
        angle: function(params(steering_angle=angle, closest_waypoints=[31, 32]))
        for angle in (0, 30)
    }

    assert on_straight[0] == on_straight[4] == 1.0
    assert 1.0 > on_straight[-12] > on_straight[20] == on_straight[30] > 0.2
    assert in_bend[30] == in_bend[0] == 1.0


def test_a_straight_is_seen_with_repeated_waypoints_and_at_the_end_of_an_open_road():
    function = reward("straights")
    points = [(0.5 * (k // 2), 0.0) for k in range(20)]

    at_end = function(params(waypoints=points, closest_waypoints=[18, 19], steering_angle=30.0))
    only_one = function(params(waypoints=[(0.0, 0.0)] * 4, closest_waypoints=[0, 1]))

    assert at_end == pytest.approx(0.3)
    assert only_one == 1.0

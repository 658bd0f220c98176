"""What reward functions are told, with objects on the track and without."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drsim.car.car import FRONT
from drsim.episode.params import Situation, params_of
from drsim.episode.simulation import Simulation
from drsim.race.objects import Objects, closest, in_camera
from drsim.race.race import BotRules, ObstacleRules, Race
from drsim.race.traffic import Traffic
from drsim.sensing.scene import build_scene
from drsim.track.ways import Ways
from drsim.track.worlds import load_track

TRACK = load_track("reinvent_base")
TRACKS = (TRACK, TRACK.reversed())
LENGTH_M = TRACK.length_m
BOX_M = (0.5, 0.4)

OBJECT_KEYS = {
    "closest_objects": [0, 0],
    "objects_location": [],
    "objects_left_of_center": [],
    "object_in_camera": False,
    "objects_speed": [],
    "objects_heading": [],
    "objects_distance_from_center": [],
    "objects_distance": [],
}
NUMBER_OF_KEYS = 27


def objects_at(distance_m, *, xy=None, yaw_rad=None) -> Objects:
    """Boxes of one car at distances along the lap; places and directions only where they matter."""
    count = len(distance_m)
    return Objects(
        xy=np.zeros((1, count, 2)) if xy is None else np.array([xy], np.float64),
        yaw_rad=np.zeros((1, count)) if yaw_rad is None else np.array([yaw_rad], np.float64),
        footprint_m=np.tile(BOX_M, (count, 1)),
        distance_m=np.array([distance_m], np.float64),
        from_center_m=np.zeros((1, count)),
        left_of_center=np.zeros((1, count), np.bool_),
        speed_mps=np.zeros(count),
        tells_heading=np.zeros(count, np.bool_),
    )


def situation(objects: Objects | None, at_m, crashed=False, backward: int = 0) -> Situation:
    """Cars on the centre line, at distances from waypoint 0 in their driving direction."""
    poses = TRACKS[backward].pose_at(np.asarray(at_m, np.float64))
    count = len(poses)
    return Situation(
        xy=poses[:, :2],
        heading_deg=np.degrees(poses[:, 2]),
        where=TRACKS[backward].locate(poses[:, :2]),
        all_on=np.ones(count, np.bool_),
        none_on=np.zeros(count, np.bool_),
        progress=np.full(count, 10.0),
        steps=np.full(count, 3),
        sim_time_s=np.full(count, 0.2),
        steering_deg=np.full(count, -15.0),
        speed_mps=np.full(count, 1.5),
        way=np.full(count, backward),
        crashed=np.full(count, crashed),
        objects=objects,
    )


def told(traffic: Traffic, at_m: float, *, crashed=False, backward: int = 0) -> dict:
    """The parameters of the only car."""
    now = situation(traffic.objects(), [at_m], crashed, backward)
    (params,) = params_of(TRACKS, now, np.array([0]))
    return params


def traffic_of(backward: int = 0, seed: int = 1, **race) -> Traffic:
    traffic = Traffic(Ways(TRACKS[:1], 1), Race(**race))
    car = np.zeros(1, np.int64)
    traffic.ways.choose(car, 0, backward == 1)
    traffic.begin(car, np.zeros(1), np.array([seed], np.uint64))
    return traffic


BOXES = ObstacleRules(positions=((0.25, 1), (0.5, -1), (0.75, 1)))


@pytest.mark.parametrize("traffic", [None, traffic_of(obstacles=ObstacleRules(count=0))])
def test_without_objects_the_keys_about_them_keep_their_defaults(traffic) -> None:
    now = situation(None if traffic is None else traffic.objects(), [1.0])

    (params,) = params_of(TRACKS, now, np.array([0]))

    assert len(params) == NUMBER_OF_KEYS
    assert {key: params[key] for key in OBJECT_KEYS} == OBJECT_KEYS


def test_every_value_about_objects_is_plain_python() -> None:
    params = told(traffic_of(obstacles=BOXES, bots=BotRules(count=1)), 1.0)

    assert len(params) == NUMBER_OF_KEYS
    assert [type(index) for index in params["closest_objects"]] == [int, int]
    assert type(params["object_in_camera"]) is bool
    assert type(params["is_crashed"]) is bool
    for key in ("objects_speed", "objects_heading", "objects_distance"):
        assert [type(value) for value in params[key]] == [float] * 4
    assert [type(value) for value in params["objects_distance_from_center"]] == [float] * 4
    assert [type(value) for value in params["objects_left_of_center"]] == [bool] * 4
    assert [[type(v) for v in xy] for xy in params["objects_location"]] == [[float, float]] * 4


@pytest.mark.parametrize("backward", [0, 1])
def test_boxes_are_told_as_they_stand(backward) -> None:
    traffic = traffic_of(backward, obstacles=BOXES)

    params = told(traffic, 1.0, backward=backward)

    where = TRACKS[backward].locate(np.array(params["objects_location"]))
    np.testing.assert_array_equal(params["objects_location"], traffic.xy[0])
    np.testing.assert_allclose(params["objects_distance"], where.distance_m)
    np.testing.assert_allclose(params["objects_distance_from_center"], where.from_center_m)
    inside_is_left = backward == 0
    left = [inside_is_left, not inside_is_left, inside_is_left]
    assert params["objects_left_of_center"] == left
    assert params["objects_speed"] == [0.0] * 3
    assert params["objects_heading"] == [0.0] * 3, "though they are turned with the lane"
    assert np.abs(traffic.yaw_rad).min() > 0.01


def test_bots_tell_their_heading_in_radians_and_their_speed_even_while_they_wait() -> None:
    traffic = traffic_of(bots=BotRules(speed_mps=0.7))

    params = told(traffic, 1.0)

    assert params["objects_speed"] == [0.7] * 3
    assert params["objects_heading"] == traffic.yaw_rad[0].tolist()
    assert max(abs(rad) for rad in params["objects_heading"]) <= math.pi


def test_a_crash_is_told() -> None:
    traffic = traffic_of(obstacles=BOXES)

    assert told(traffic, 1.0, crashed=True)["is_crashed"] is True
    assert told(traffic, 1.0)["is_crashed"] is False


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.1, [2, 0]), (0.3, [0, 1]), (0.6, [1, 2]), (0.9, [2, 0])],
)
def test_the_closest_objects_are_those_before_and_after_along_the_lap(share, expected) -> None:
    params = told(traffic_of(obstacles=BOXES), share * LENGTH_M)

    assert params["closest_objects"] == expected


def test_the_only_object_is_both_before_and_after() -> None:
    params = told(traffic_of(obstacles=ObstacleRules(positions=((0.5, 1),))), 1.0)

    assert params["closest_objects"] == [0, 0]


@given(
    st.lists(st.sampled_from([0.0, 1.0, 2.5, 17.0]) | st.floats(0, 17), min_size=1, max_size=6),
    st.floats(0.0, 17.0) | st.sampled_from([1.0, 2.5]),
)
def test_the_closest_objects_are_those_that_sorting_finds(distance_m, here_m) -> None:
    objects = objects_at(distance_m)

    previous, following = closest(objects.distance_m, np.array([0]), np.array([here_m]))

    order = sorted(range(len(distance_m)), key=lambda k: distance_m[k])
    passed = sum(there_m <= here_m for there_m in distance_m)
    assert previous.tolist() == [order[passed - 1]]
    assert following.tolist() == [order[passed % len(order)]]


@pytest.mark.parametrize(
    ("ahead_m", "left_m", "seen"),
    [
        (1.0, 0.0, True),
        (4.0, 0.0, True),
        (-1.0, 0.0, False),
        (1.0, 0.8, True),
        (1.0, 1.5, False),
        (1.0, -1.5, False),
        (0.1, 0.0, True),
        (-0.3, 0.0, False),
    ],
)
def test_the_camera_sees_the_next_object_where_it_is_in_the_picture(ahead_m, left_m, seen) -> None:
    # Nose at the origin, looking along +y.
    objects = objects_at([3.0], xy=[[-left_m, ahead_m]], yaw_rad=[math.pi / 2])

    found = in_camera(
        objects[:3], np.array([0]), np.array([0]), np.zeros((1, 2)), np.array([math.pi / 2])
    )

    assert found.tolist() == [seen]


@given(
    nose=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    heading_rad=st.floats(-4, 4),
    place=st.tuples(st.floats(-4, 4), st.floats(-4, 4)),
    yaw_rad=st.floats(-4, 4),
)
def test_what_the_camera_sees_is_what_its_lens_projects_into_the_picture(
    nose, heading_rad, place, yaw_rad
) -> None:
    # The lens as matrices: a car turned by its heading, a lens tilted by its pitch.
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    turned = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    c, s = math.cos(FRONT.pitch_rad), math.sin(FRONT.pitch_rad)
    axes = turned @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # forward, left, up in columns
    lens = turned @ (np.array(FRONT.mount_m) - [0.14, 0, 0]) + [*nose, 0]
    along = 0.5 * BOX_M[0] * np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    across = 0.5 * BOX_M[1] * np.array([-math.sin(yaw_rad), math.cos(yaw_rad)])
    corners = [a * along + b * across for a, b in ((0, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))]
    margins = []
    for corner in corners:
        depth, left, up = axes.T @ (np.array([*(np.array(place) + corner), 0]) - lens)
        wide = depth * FRONT.columns / 2 / FRONT.focal_px
        high = depth * FRONT.rows / 2 / FRONT.focal_px
        margins.append(min(depth - 0.2, wide - abs(left), high - abs(up)))
    assume(abs(max(margins)) > 1e-9)

    found = in_camera(
        objects_at([3.0], xy=[place], yaw_rad=[yaw_rad])[:3],
        np.array([0]),
        np.array([0]),
        np.array([nose]),
        np.array([heading_rad]),
    )

    assert found.tolist() == [max(margins) > 0]


def test_the_flag_belongs_to_the_next_object_and_not_to_the_one_listed_before_it() -> None:
    # One box ahead, and one just behind the car; the one ahead is listed first.
    ahead_m, behind_m = 6.0, 4.6
    traffic = traffic_of(
        obstacles=ObstacleRules(positions=((ahead_m / LENGTH_M, 1), (behind_m / LENGTH_M, 1)))
    )

    near = told(traffic, 5.0)
    past = told(traffic, 6.6)

    assert near["closest_objects"] == [1, 0]
    assert near["object_in_camera"] is True
    assert past["closest_objects"] == [0, 1]
    assert past["object_in_camera"] is False, "the next one is most of a lap away"


def test_a_reward_function_may_alter_what_it_is_given() -> None:
    traffic = traffic_of(obstacles=BOXES)
    first = told(traffic, 1.0)
    untouched = {key: repr(value) for key, value in first.items()}

    for key in OBJECT_KEYS:
        if isinstance(first[key], list):
            first[key].append("mine")
    first["objects_location"][0].append("mine")

    assert {key: repr(value) for key, value in told(traffic, 1.0).items()} == untouched


# Three reward functions of the kind that public examples use, with their habits.


def reward_for_lane_and_distance(params):
    """Stay on the track and away from the next object when it is on the same lane."""
    all_wheels_on_track = params["all_wheels_on_track"]
    distance_from_center = params["distance_from_center"]
    track_width = params["track_width"]
    objects_location = params["objects_location"]
    agent_x = params["x"]
    agent_y = params["y"]
    _, next_object_index = params["closest_objects"]
    objects_left_of_center = params["objects_left_of_center"]
    is_left_of_center = params["is_left_of_center"]

    reward = 1e-3
    if all_wheels_on_track and (0.5 * track_width - distance_from_center) >= 0.05:
        reward_lane = 1.0
    else:
        reward_lane = 1e-3
    reward_avoid = 1.0
    next_object_loc = objects_location[next_object_index]
    distance_closest_object = math.sqrt(
        (agent_x - next_object_loc[0]) ** 2 + (agent_y - next_object_loc[1]) ** 2
    )
    is_same_lane = objects_left_of_center[next_object_index] == is_left_of_center
    if is_same_lane:
        if 0.5 <= distance_closest_object < 0.8:
            reward_avoid *= 0.5
        elif 0.3 <= distance_closest_object < 0.5:
            reward_avoid *= 0.2
        elif distance_closest_object < 0.3:
            reward_avoid = 1e-3
    reward += 1.0 * reward_lane + 4.0 * reward_avoid
    return reward


def reward_for_overtaking(params):
    """Gain on the bot ahead, with its heading and speed, unless the camera does not show it."""
    objects_speed = params["objects_speed"]
    objects_heading = params["objects_heading"]
    next_index = params["closest_objects"][1]
    gap = (params["objects_distance"][next_index] - params["projection_distance"]) % params[
        "track_length"
    ]
    closing = params["speed"] - objects_speed[next_index] * math.cos(
        math.radians(params["heading"]) - objects_heading[next_index]
    )
    reward = 1.0 + 0.1 * closing / (0.1 + gap)
    if params["object_in_camera"] and gap < 0.5:
        reward *= 0.5
    if params["is_crashed"] or params["is_offtrack"]:
        reward = 1e-3
    return float(reward)


def reward_for_the_free_lane(params):
    """Sort all objects by distance along the lap and keep to the lane that the next one leaves."""
    length = params["track_length"]
    here = params["projection_distance"]
    objects = sorted(
        zip(
            params["objects_distance"],
            params["objects_left_of_center"],
            params["objects_distance_from_center"],
            strict=True,
        ),
        key=lambda found: (found[0] - here) % length,
    )
    distance, left, aside = objects[0]
    near = (distance - here) % length < 2.0
    if not near:
        return max(1e-3, 1.0 - (params["distance_from_center"] / (0.5 * params["track_width"])))
    free = left != params["is_left_of_center"]
    return 1.0 + aside if free else 0.1


@pytest.fixture(scope="module")
def scene():
    return build_scene(TRACK)


@pytest.mark.parametrize(
    "reward_function",
    [reward_for_lane_and_distance, reward_for_overtaking, reward_for_the_free_lane],
)
@pytest.mark.parametrize(
    "race",
    [
        Race(obstacles=ObstacleRules()),
        Race(obstacles=ObstacleRules(randomize=True, kind="bot_car")),
        Race(bots=BotRules(lane_change=True)),
        Race(racers=2),
    ],
    ids=["boxes", "parked cars", "bots", "racers"],
)
def test_public_kinds_of_reward_functions_run_in_every_race(reward_function, race, scene) -> None:
    simulation = Simulation(
        TRACK, num_cars=2, reward_function=reward_function, scene=scene, race=race
    )
    rewards = []
    try:
        simulation.reset(
            np.arange(2), np.array([0.2, 0.7]), reverse=np.array([False, race.racers < 2])
        )
        for _ in range(25):
            result = simulation.step(np.zeros(2), np.full(2, 1.0))
            rewards.extend(result.reward[result.driven])
    finally:
        simulation.close()

    assert len(rewards) > 10
    assert np.isfinite(rewards).all()
    assert np.ptp(rewards) > 0

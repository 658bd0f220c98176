"""Whole episodes: what a driver, a reward function and a trace see of them."""

import numpy as np
import pytest

import drsim
from drsim.episode.episode_rules import EpisodeRules, Status, StepResult
from drsim.episode.simulation import Simulation
from drsim.errors import RewardError
from drsim.track.track import Track
from drsim.track.worlds import load_track
from simulations import simulations

KEYS_AND_TYPES = {
    "all_wheels_on_track": bool,
    "x": float,
    "y": float,
    "heading": float,
    "distance_from_center": float,
    "projection_distance": float,
    "progress": float,
    "steps": float,
    "speed": float,
    "steering_angle": float,
    "track_width": float,
    "track_length": float,
    "waypoints": list,
    "closest_waypoints": list,
    "is_left_of_center": bool,
    "is_reversed": bool,
    "closest_objects": list,
    "objects_location": list,
    "objects_left_of_center": list,
    "object_in_camera": bool,
    "objects_speed": list,
    "objects_heading": list,
    "objects_distance_from_center": list,
    "objects_distance": list,
    "is_crashed": bool,
    "is_offtrack": bool,
    "sim_time": float,
}


@pytest.fixture(scope="module")
def track() -> Track:
    return load_track("reinvent_base")


@pytest.fixture(scope="module")
def simulate(track):
    """Build simulations of one track that share its scene."""
    with simulations(track) as simulate:
        yield simulate


def towards_the_line(track: Track, row: StepResult) -> np.ndarray:
    """Steering of a pure-pursuit driver that aims at the centre line half a metre ahead."""
    here = np.stack([row.x, row.y], axis=1)
    goal = track.pose_at(track.locate(here).distance_m + 0.5)[:, :2] - here
    error = np.arctan2(goal[:, 1], goal[:, 0]) - np.radians(row.yaw_deg)
    return np.clip(1.5 * np.degrees((error + np.pi) % (2 * np.pi) - np.pi), -30, 30)


def drive(simulation: Simulation, row: StepResult, track: Track, speed_mps: float = 1.2):
    """Drive all cars along the line until every episode is over; yield every row."""
    running = ~row.done
    while running.any():
        steering_deg = towards_the_line(track, row)
        row = simulation.step(steering_deg, np.full(simulation.num_cars, speed_mps))
        running &= ~row.done
        yield row


def straight(simulation: Simulation, steps: int) -> list[StepResult]:
    size = simulation.num_cars
    return [simulation.step(np.zeros(size), np.ones(size)) for _ in range(steps)]


def test_the_first_row_is_a_prepare_step_without_reward(simulate, track):
    calls = []
    simulation = simulate(reward_function=lambda params: calls.append(params) or 1.0)

    row = simulation.reset(np.array([0]), np.array([0.0]))

    assert Status(int(row.status[0])) is Status.PREPARE
    assert (row.steps[0], row.reward[0], row.driven[0]) == (1, 0.0, False)
    assert row.progress[0] == pytest.approx(14 / track.length_m, abs=0.02)
    assert calls == []
    assert simulation.observations[0].any()


def test_the_first_frame_shows_the_start_and_not_where_the_last_episode_ended(simulate):
    simulation = simulate()
    simulation.reset(np.array([0]), np.array([0.2]))
    at_start = simulation.observations[0].copy()
    straight(simulation, 5)

    simulation.reset(np.array([0]), np.array([0.2]))

    np.testing.assert_array_equal(simulation.observations[0], at_start)


def test_the_first_reward_call_has_steps_two_and_all_keys_with_their_types(simulate, track):
    seen = []
    simulation = simulate(reward_function=lambda params: seen.append(params) or 1.0)
    simulation.reset(np.array([0]), np.array([0.0]))

    simulation.step(np.array([-41.5]), np.array([5.25]))

    params = seen[0]
    assert {key: type(value) for key, value in params.items()} == KEYS_AND_TYPES
    assert params["steps"] == 2.0
    assert (params["speed"], params["steering_angle"]) == (5.25, -41.5)  # as asked, not clipped
    assert params["waypoints"] == track.waypoints
    assert all(type(index) is int for index in params["closest_waypoints"])
    assert params["track_length"] == track.length_m


def test_a_reward_function_may_alter_its_parameters_without_harm(simulate, track):
    seen = []

    def greedy(params):
        seen.append((len(params["waypoints"]), params["closest_objects"]))
        params["waypoints"].clear()
        params["closest_objects"].append(7)
        params.clear()
        return 0.0

    simulation = simulate(reward_function=greedy)
    simulation.reset(np.array([0]), np.array([0.0]))

    straight(simulation, 2)

    assert [length for length, _ in seen] == [len(track.waypoints)] * 2
    assert seen[1][1] == [0, 0, 7]  # only what it did itself


def test_parameters_describe_the_pose_after_the_motion_of_the_step(simulate):
    seen = []
    simulation = simulate(reward_function=lambda params: seen.append(params) or 0.25)
    simulation.reset(np.array([0]), np.array([0.0]))

    rows = straight(simulation, 4)

    assert [params["x"] for params in seen] == [row.x[0] for row in rows]
    assert [params["progress"] for params in seen] == [row.progress[0] for row in rows]
    assert [params["sim_time"] for params in seen] == [row.sim_time_s[0] for row in rows]
    assert [row.reward[0] for row in rows] == [0.25] * 4
    assert rows[3].x[0] != rows[2].x[0]


def test_steps_and_clock_advance_fifteen_times_a_second(simulate):
    simulation = simulate()
    first = simulation.reset(np.array([0]), np.array([0.0]))

    rows = straight(simulation, 15)

    assert [row.steps[0] for row in rows] == list(range(2, 17))
    assert rows[-1].sim_time_s[0] - first.sim_time_s[0] == pytest.approx(1.0)


def test_the_clock_goes_on_over_episodes(simulate):
    simulation = simulate()
    simulation.reset(np.array([0]), np.array([0.0]))
    last = straight(simulation, 3)[-1]

    again = simulation.reset(np.array([0]), np.array([0.0]))

    assert again.sim_time_s[0] > last.sim_time_s[0]
    assert again.steps[0] == 1


@pytest.mark.parametrize("start", [0.0, 0.37])
def test_a_driven_lap_ends_at_exactly_one_hundred(simulate, track, start):
    simulation = simulate()
    first = simulation.reset(np.array([0]), np.array([start]))

    rows = list(drive(simulation, first, track))

    progress = np.array([row.progress[0] for row in rows])
    assert progress[-1] == 100.0
    assert (progress[:-1] < 100.0).all()
    assert (np.diff(progress) > 0).all()
    assert Status(int(rows[-1].status[0])) is Status.LAP_COMPLETE
    assert rows[-1].terminated[0]
    assert rows[-1].laps[0] == 1
    assert 10.0 < rows[-1].lap_time_s[0] < 20.0
    assert rows[-1].lap_time_s[0] == pytest.approx(rows[-1].sim_time_s[0] - first.sim_time_s[0])


def test_a_lap_can_be_driven_the_other_way(simulate, track):
    seen = []
    simulation = simulate(
        num_cars=2, reward_function=lambda params: seen.append(params["is_reversed"]) or 1.0
    )
    first = simulation.reset(
        np.array([0, 1]), np.array([0.1, 0.1]), reverse=np.array([True, False])
    )

    rows = list(drive(simulation, first, track.reversed()))  # car 1 has to turn round, and leaves

    assert rows[-1].progress[0] == 100.0
    assert abs((first.yaw_deg[0] - first.yaw_deg[1] + 360) % 360) > 20
    assert set(seen) == {True, False}
    assert any(row.status[1] == Status.OFF_TRACK for row in rows)


def test_leaving_the_track_ends_the_episode_with_a_last_reward(simulate):
    seen = []
    simulation = simulate(reward_function=lambda params: seen.append(params) or 0.5)
    simulation.reset(np.array([0]), np.array([0.0]))

    for _ in range(60):
        row = simulation.step(np.array([30.0]), np.array([1.0]))
        if row.done[0]:
            break

    assert row.terminated[0]
    assert Status(int(row.status[0])) is Status.OFF_TRACK
    assert row.reward[0] == 0.5
    assert seen[-1]["is_offtrack"] is True
    assert seen[-1]["all_wheels_on_track"] is False
    assert [params["is_offtrack"] for params in seen[:-1]] == [False] * (len(seen) - 1)


def test_steps_tell_how_long_the_reward_function_of_each_car_took(simulate):
    clock_s = [0.0]

    def working(seconds: float):
        def reward_function(params):
            clock_s[0] += seconds
            return 1.0

        return reward_function

    simulation = simulate(
        3,
        [working(0.002), working(0.5), working(9.0)],
        reward_clock=lambda: clock_s[0],
    )
    first = simulation.reset(np.arange(2), np.array([0.1, 0.5]))
    row = straight(simulation, 1)[-1]

    assert first.reward_time_s.tolist() == [0.0, 0.0, 0.0]
    assert row.driven.tolist() == [True, True, False]
    assert row.reward_time_s.tolist() == pytest.approx([0.002, 0.5, 0.0])


def test_a_finished_car_stays_parked_while_others_go_on(simulate):
    simulation = simulate(num_cars=2, rules=EpisodeRules(max_steps=5))
    simulation.reset(np.array([0]), np.array([0.0]))
    ended = straight(simulation, 4)[-1]
    simulation.reset(np.array([1]), np.array([0.5]))

    row = straight(simulation, 1)[0]

    assert ended.truncated[0]
    assert Status(int(row.status[0])) is Status.PARK
    assert (row.driven[0], row.reward[0], row.done[0]) == (False, 0.0, False)
    assert (row.x[0], row.sim_time_s[0]) == (ended.x[0], ended.sim_time_s[0])
    assert row.driven[1]


def test_an_evaluated_car_that_leaves_the_track_waits_and_goes_on_where_it_left(simulate, track):
    simulation = simulate(rules=EpisodeRules.evaluation(max_resets=3))
    row = simulation.reset(np.array([0]), np.array([0.6]))
    for _ in range(60):
        before, row = row, simulation.step(np.array([-30.0]), np.array([1.2]))
        if row.status[0] == Status.OFF_TRACK:
            break

    waiting = straight(simulation, 30)
    going_on = straight(simulation, 1)[0]

    assert not row.done[0]
    assert row.pause_s[0] == 2.0  # the full pause stands in the row of the violation
    assert row.resets[0] == 1
    assert {int(r.status[0]) for r in waiting} == {Status.PAUSE}
    np.testing.assert_allclose([r.pause_s[0] for r in waiting], np.arange(29, -1, -1) / 15)
    assert [r.reward[0] for r in waiting] == [0.0] * 30
    assert len({(r.x[0], r.y[0]) for r in waiting}) == 1
    assert waiting[0].all_wheels_on_track[0]
    assert waiting[0].progress[0] == pytest.approx(
        before.progress[0] + 14 / track.length_m, abs=1.5
    )
    assert Status(int(going_on.status[0])) is Status.IN_PROGRESS
    assert going_on.driven[0]
    assert going_on.steps[0] == row.steps[0] + 31


def test_each_episode_begins_its_calls_with_step_two_and_being_put_back_begins_no_new_count(
    simulate,
):
    told, driven_steps = [], []
    simulation = simulate(
        reward_function=lambda params: told.append(params["steps"]) or 1.0,
        rules=EpisodeRules.evaluation(max_resets=3, off_track_penalty_s=0.2),
    )
    for _ in range(2):
        simulation.reset(np.array([0]), np.array([0.6]))
        for _ in range(60):
            row = simulation.step(np.array([-30.0]), np.array([1.2]))
            if row.driven[0]:
                driven_steps.append(row.steps[0])
        assert row.resets[0] > 0

    assert told == driven_steps
    assert [k for k, steps in enumerate(told) if steps == 2] == [0, len(told) // 2]
    assert min(told) == 2


def test_a_car_is_put_back_on_the_lane_it_left_from(simulate, track):
    simulation = simulate(num_cars=2, rules=EpisodeRules.evaluation(max_resets=1))
    simulation.reset(np.array([0, 1]), np.zeros(2))
    put_back = {}
    for _ in range(60):
        row = simulation.step(np.array([30.0, -30.0]), np.ones(2))
        for car in np.flatnonzero(row.status == Status.PAUSE):
            put_back.setdefault(int(car), np.array([row.x[car], row.y[car]]))

    left, right = (track.locate(put_back[car][None]) for car in (0, 1))

    assert left.left_of_center[0]
    assert not right.left_of_center[0]
    # The lane lies midway between the line and the border.
    assert left.from_center_m[0] == pytest.approx(left.track_width_m[0] / 4, abs=0.05)


def test_a_continuous_evaluation_counts_three_laps_in_one_episode(simulate, track):
    simulation = simulate(rules=EpisodeRules.evaluation(laps=3))
    first = simulation.reset(np.array([0]), np.array([0.5]))

    rows = list(drive(simulation, first, track))

    finishes = [row for row in rows if row.progress[0] == 100.0]
    assert [row.laps[0] for row in finishes] == [1, 2, 3]
    assert [Status(int(row.status[0])) for row in finishes] == [
        Status.IN_PROGRESS,
        Status.IN_PROGRESS,
        Status.LAP_COMPLETE,
    ]
    total_s = rows[-1].sim_time_s[0] - first.sim_time_s[0]
    assert sum(row.lap_time_s[0] for row in finishes) == pytest.approx(total_s)
    after = rows[rows.index(finishes[0]) + 1]
    assert 0.0 < after.progress[0] < 2.0


@pytest.mark.parametrize("num_cars", [1, 7])
def test_the_same_actions_give_the_same_bits_again_and_at_any_thread_count(simulate, num_cars):
    actions = np.random.default_rng(3).uniform([-25.0, 0.8], [25.0, 1.6], (100, num_cars, 2))
    starts = np.linspace(0.0, 0.9, num_cars)
    runs = []

    for num_threads in (1, 2, 2):
        simulation = simulate(num_cars=num_cars, num_threads=num_threads)
        simulation.reset(np.arange(num_cars), starts)
        frames, rewards = [], []
        for action in actions:
            row = simulation.step(action[:, 0], action[:, 1])
            frames.append(simulation.observations.copy())
            rewards.append(row.reward)
            if row.done.any():
                over = np.flatnonzero(row.done)
                simulation.reset(over, starts[over])
        runs.append((np.stack(frames), np.stack(rewards)))

    for frames, rewards in runs[1:]:
        np.testing.assert_array_equal(frames, runs[0][0])
        np.testing.assert_array_equal(rewards, runs[0][1])


def test_a_car_that_starts_beside_the_line_does_not_move_the_others(simulate):
    starts = np.linspace(0.0, 0.95, 60)
    poses = []
    for offset_m in (None, np.eye(61)[60] / 50.0):
        simulation = simulate(num_cars=61)
        simulation.reset(np.arange(61), np.append(starts, 0.5), offset_m=offset_m)
        rows = straight(simulation, 30)
        poses.append([(row.x[:60], row.y[:60], row.yaw_deg[:60]) for row in rows])

    np.testing.assert_array_equal(*poses)


def test_a_failing_reward_function_ends_the_step_with_its_line(simulate):
    def faulty(params):
        return 1.0 / (params["steps"] - 3.0)

    simulation = simulate(reward_function=faulty)
    simulation.reset(np.array([0]), np.array([0.0]))
    straight(simulation, 1)

    with pytest.raises(RewardError, match="ZeroDivisionError") as caught:
        straight(simulation, 1)

    assert "params[" in caught.value.source
    assert caught.value.params["steps"] == 3.0


def test_an_endless_loop_in_the_reward_function_is_cut(simulate):
    def endless(params):
        while True:
            pass

    simulation = simulate(reward_function=endless, reward_deadline_s=0.1)
    simulation.reset(np.array([0]), np.array([0.0]))

    with pytest.raises(RewardError, match="endless loop"):
        straight(simulation, 1)


class Broken(Exception):
    """Stands for the base class of a racer."""


class DiscardEpisode(Broken):
    """Defined in the racer's own file: only the name counts."""


@pytest.mark.parametrize("raised", [DiscardEpisode, drsim.DiscardEpisode])
def test_an_episode_that_its_function_declares_broken_ends_at_once(raised):  # 001-17
    told = []

    def broken(params):
        if params["steps"] == 4:
            raise raised("the car is lost")
        return 1.0

    def tell(error, calls):
        told.append((error.kind, error.reason, calls))
        return 7.0

    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=2,
        reward_function=[broken, lambda params: 1.0],
        num_threads=1,
        on_reward_error=tell,
    )
    simulation.reset(np.arange(2), np.zeros(2))
    results = [simulation.step(np.zeros(2), np.ones(2)) for _ in range(4)]
    simulation.close()

    ended = results[2]
    assert ended.status[0] == Status.DISCARDED
    assert Status.DISCARDED.label == "discarded"
    assert (ended.truncated[0], ended.terminated[0], ended.reward[0]) == (True, False, 0.0)
    assert not ended.done[1], "the other car drives on"
    assert results[3].driven.tolist() == [False, True]
    assert told == [("discard", f"{raised.__name__}: the car is lost", 5)]


@pytest.mark.parametrize(
    ("returned", "kind"),
    [
        (None, "type"),
        ("1.0", "type"),
        (1j, "type"),
        ([1.0, 2.0], "type"),
        (float("nan"), "range"),
        (float("inf"), "range"),
        (1e6, "range"),
    ],
)
def test_a_step_without_a_reward_gets_the_one_that_is_given_instead(returned, kind):  # 001-17
    errors = []

    def instead(error, calls):
        errors.append(error)
        return 0.25

    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=1,
        reward_function=lambda params: returned,
        num_threads=1,
        on_reward_error=instead,
    )
    simulation.reset(np.zeros(1, int), np.zeros(1))
    result = simulation.step(np.zeros(1), np.ones(1))
    simulation.close()

    assert result.reward[0] == 0.25
    assert not result.done[0]
    assert [error.kind for error in errors] == [kind]
    assert "progress" in errors[0].params


def test_a_call_that_does_not_return_ends_the_run_whatever_is_given_instead():
    def endless(params):
        while True:
            pass

    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=1,
        reward_function=endless,
        num_threads=1,
        reward_deadline_s=0.05,
        on_reward_error=lambda error, calls: 0.0,
    )
    simulation.reset(np.zeros(1, int), np.zeros(1))
    with pytest.raises(RewardError, match=r"did not return within 0\.05 s"):
        simulation.step(np.zeros(1), np.ones(1))
    simulation.close()

from dataclasses import replace

import pytest

from drcli.records.episode_metrics import EpisodeMetrics, TrialMetrics
from drcli.records.trace import CSV_HEADER, Episode, Row, csv_text, log_lines, read_csv, schedule

STEP_S = 1 / 15


def test_a_trace_has_the_reference_columns_and_plain_values():
    episode = _episode(3, rewards=[0.0, 1.5], end="off_track")

    header, first, last = csv_text([episode], (100.0, 101.0)).splitlines()

    assert header == CSV_HEADER
    assert first.split(",")[:3] == ["3", "1.0", "1.25"]
    assert dict(zip(header.split(","), last.split(","), strict=True)) == {
        "episode": "3",
        "steps": "2.0",
        "X": "1.25",
        "Y": "-2.5",
        "yaw": "10.0",
        "steer": "-15.0",
        "throttle": "1.2",
        "action": "4",
        "reward": "1.5",
        "done": "True",
        "all_wheels_on_track": "True",
        "progress": "2.0",
        "closest_waypoint": "7",
        "track_len": "17.709",
        "tstamp": str(2 * STEP_S),
        "episode_status": "off_track",
        "pause_duration": "0.0",
        "obstacle_crash_counter": "0",
        "wall_clock": "101.0",
        "reward_ms": "1.235",
    }
    assert first.split(",")[-1] == "0.0"


def test_our_column_comes_after_the_reference_ones_and_never_into_the_log():
    episode = _episode(0, rewards=[0.0, 1.0], end="off_track")

    assert CSV_HEADER.split(",")[18:] == ["wall_clock", "reward_ms"]
    for line in log_lines(episode, 1.0).splitlines():
        assert len(line.split(",")) == 19


def test_traces_without_our_column_read_the_same():
    episodes = [_episode(n, [0.0, 1.5, 2.0], "off_track") for n in range(2)]
    text = csv_text(episodes, (100.0, 101.0))
    old = "\n".join(line.rpartition(",")[0] for line in text.splitlines()) + "\n"

    assert read_csv(old.encode()) == read_csv(text.encode())
    assert [traced.reward for traced in read_csv(old.encode())] == [3.5, 3.5]


def test_rows_of_equal_drives_are_equal_whatever_the_reward_function_took():
    [row, *_] = _episode(0, [0.0, 1.0], "off_track").rows

    assert replace(row, reward_ms=7.0) == row
    assert replace(row, reward=7.0) != row


def test_a_log_line_has_the_reference_decimals():
    episode = _episode(0, rewards=[0.0, 0.12345], end="lap_complete")

    line = log_lines(episode, 1760000000.12345).splitlines()[1]

    assert line == (
        "SIM_TRACE_LOG:0,2,1.2500,-2.5000,10.0000,-15.00,1.20,4,0.1235,True,True,2.0000,7,17.71,"
        f"{2 * STEP_S},lap_complete,0.00,0,1760000000.1235"
    )


def test_episodes_driven_side_by_side_get_consecutive_places_on_one_clock():
    episodes = [_episode(0, [0.0, 1.0], "off_track"), _episode(1, [0.0] * 4, "off_track")]

    end_s = schedule(episodes, clock_s=10.0)

    assert episodes[0].clock_s == 10.0
    assert episodes[1].clock_s == 10.0 + 3 * STEP_S
    assert end_s == episodes[1].clock_s + 5 * STEP_S


def test_wall_clock_spreads_over_the_rows_so_that_time_never_runs_backwards():
    episodes = [_episode(0, [0.0] * 3, "off_track"), _episode(1, [0.0], "off_track")]

    rows = csv_text(episodes, (50.0, 54.0)).splitlines()[1:]

    assert [float(row.split(",")[18]) for row in rows] == [51.0, 52.0, 53.0, 54.0]


def test_a_metrics_record_agrees_with_the_trace():
    episode = _episode(4, rewards=[0.0, 2.4, 3.3], end="lap_complete", progress=100.0)
    episode.clock_s = 2.0

    record = EpisodeMetrics.of(episode, iteration=0, episode=5, trial=5)

    assert record.to_json() == {
        "reward_score": 6,
        "metric_time": 2200,
        "start_time": 2000,
        "elapsed_time_in_milliseconds": 200,
        "episode": 5,
        "trial": 5,
        "phase": "training",
        "completion_percentage": 100,
        "episode_status": "Lap complete",
        "iteration": 0,
    }


@pytest.mark.parametrize(
    ("end", "off_track", "resets"),
    [
        ("lap_complete", 1, 1),
        ("off_track", 2, 1),
        ("crashed", 1, 1),
        ("time_up", 1, 1),
        ("discarded", 1, 1),
        ("park", 1, 1),
    ],
)
def test_every_violation_but_the_one_that_ended_a_trial_put_the_car_back(end, off_track, resets):
    episode = _episode(0, rewards=[0.0] * 9, end=end, progress=100.0 * (end == "lap_complete"))
    episode.rows[4] = replace(episode.rows[4], status="off_track")

    record = TrialMetrics.of(episode)

    assert (record.off_track_count, record.reset_count) == (off_track, resets)
    assert not record.clean


def test_a_trial_knows_what_it_waited_and_is_clean_without_a_violation_only():
    episode = _episode(0, rewards=[0.0] * 9, end="lap_complete", progress=100.0)

    clean = TrialMetrics.of(episode)
    episode.rows[3:6] = [replace(row, status="pause") for row in episode.rows[3:6]]
    waited = TrialMetrics.of(episode)

    assert (clean.clean, clean.penalty_in_milliseconds) == (True, 0)
    assert (waited.clean, waited.penalty_in_milliseconds) == (False, 200)
    assert clean.end_waypoint == 7
    assert "start_position" not in clean.to_json()


def _episode(number: int, rewards: list[float], end: str, progress: float = 2.0) -> Episode:
    rows = [
        Row(
            steps=step,
            x=1.25,
            y=-2.5,
            yaw_deg=10.0,
            steering_deg=-15.0,
            speed_mps=1.2,
            action="4",
            reward=reward,
            done=step == len(rewards),
            all_wheels_on_track=True,
            progress=progress,
            closest_waypoint=7,
            status=end if step == len(rewards) else "in_progress",
            pause_s=0.0,
            time_s=step * STEP_S,
            reward_ms=1.23456 if step > 1 else 0.0,
        )
        for step, reward in enumerate(rewards, start=1)
    ]
    return Episode(number, "training", rows, track_length_m=17.709)

"""Simtraces as laps: ours, the reference's, and damaged ones."""

import numpy as np
import pytest

from drcli.base.errors import SettingsError
from drcli.records.evaluation_task import RaceRecording, RecordedObjects
from drcli.view.video.recorded_lap import read_laps
from drsim.track.worlds import load_track
from recorded_drives import trace_csv, trace_rows

TRACK = load_track("reinvent_base")


def test_a_lap_has_the_poses_of_the_cars_origin_and_the_time_of_metrics():
    [lap], notes = read_laps(trace_csv(trace_rows(TRACK)), "lap.csv")

    wanted = TRACK.pose_at(np.arange(31) * 0.1)
    np.testing.assert_allclose(lap.poses[:, :2], wanted[:, :2], atol=1e-9)
    assert lap.time_s[0] == pytest.approx(1.0 / 15.0)  # the end of the `prepare` step
    assert lap.duration_s == pytest.approx(31.0 / 15.0)
    assert lap.driven_mps[3:-3] == pytest.approx(1.5, rel=0.02)
    assert notes == []


def test_episodes_follow_each_other_even_when_they_have_the_same_number():
    first, second = trace_rows(TRACK), trace_rows(TRACK, rows=11)

    laps, _ = read_laps(trace_csv(first, second), "lap.csv")

    assert [len(lap.time_s) for lap in laps] == [31, 11]


def test_a_lap_of_a_race_without_a_stop_begins_where_the_one_before_ended():
    first = trace_rows(TRACK)
    second = trace_rows(TRACK, episode=1, clock_s=float(first[-1]["tstamp"]) + 0.05)

    laps, _ = read_laps(trace_csv(first, second), "lap.csv")

    assert [lap.time_s[0] for lap in laps] == pytest.approx([1.0 / 15.0, 0.05])


def test_the_yaw_has_no_jump_where_the_car_turns_past_west():
    rows = trace_rows(TRACK)
    for k, row in enumerate(rows):
        row["yaw"] = str((170.0 + k + 180.0) % 360.0 - 180.0)

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert np.degrees(np.diff(lap.poses[:, 2])) == pytest.approx(1.0)


def test_traces_of_older_simulators_lack_columns():
    old = ("pause_duration", "obstacle_crash_counter", "wall_clock", "episode_status")

    [lap], _ = read_laps(trace_csv(trace_rows(TRACK), without=old), "old.csv")

    assert lap.status == ("prepare", *["in_progress"] * 29, "immobilized")
    assert not lap.completed


def test_a_continuous_action_tells_what_the_columns_do_not():
    rows = trace_rows(TRACK)
    for row in rows:
        row.update(action="[-12.5 1.8]", steer="", throttle="")

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert set(lap.steering_deg) == {-12.5}
    assert set(lap.speed_mps) == {1.8}


def test_half_a_line_and_rows_without_a_place_are_left_out_and_told():
    rows = trace_rows(TRACK)
    rows[5]["X"] = "nan"
    rows[6]["tstamp"] = "soon"
    data = trace_csv(rows)[:-40]

    [lap], notes = read_laps(data, "cut.csv")

    assert len(lap.time_s) == 28
    assert notes == ["cut.csv: 3 lines cannot be read and are left out."]


def test_one_line_that_is_left_out_is_told_in_the_singular():
    _, notes = read_laps(trace_csv(trace_rows(TRACK))[:-40], "cut.csv")

    assert notes == ["cut.csv: 1 line cannot be read and is left out."]


def test_a_clock_that_stands_or_runs_back_stops_neither_film_nor_car():
    rows = trace_rows(TRACK)
    rows[10]["tstamp"] = rows[9]["tstamp"]
    rows[11]["tstamp"] = "1.0"
    for row in rows[20:]:
        row["tstamp"] = str(float(row["tstamp"]) + 300.0)

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert (np.diff(lap.time_s) > 0.0).all()
    assert lap.duration_s == pytest.approx(2.0 + 0.5, abs=0.01)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0", "is not a simtrace"),
        (b"", "is not a simtrace"),
        (b"time,name\n1,a\n", "no column X, Y, yaw, tstamp"),
        (trace_csv(trace_rows(TRACK, rows=1)), "no episode that can be shown: 1 rows"),
    ],
)
def test_a_file_without_a_lap_is_refused(data, what):
    with pytest.raises(SettingsError, match=what) as refused:
        read_laps(data, "file.csv")

    assert refused.value.remedy


def test_resets_are_counted_when_the_car_drives_on():
    rows = trace_rows(TRACK, status="lap_complete")
    for k in (8, 20):
        rows[k]["episode_status"] = "off_track"
        rows[k + 1]["episode_status"] = rows[k + 2]["episode_status"] = "pause"

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert lap.resets[[8, 9, 20, 21, 30]].tolist() == [0, 1, 1, 2, 2]
    assert lap.completed


def test_a_car_that_is_put_back_a_little_did_not_drive_there():
    rows = trace_rows(TRACK, rows=20)
    rows[8]["episode_status"] = "crashed"
    for row in rows[9:]:
        row["episode_status"] = "pause"
        row["X"], row["Y"] = str(float(rows[8]["X"]) - 0.5), rows[8]["Y"]

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert lap.driven_mps.max() < 2.0
    assert lap.driven_mps[10:] == pytest.approx(0.0, abs=0.01)


def test_episodes_and_rows_that_cannot_be_shown_are_told():
    short = trace_rows(TRACK, rows=1, episode=1, clock_s=200.0)
    late = trace_rows(TRACK, rows=9, episode=2, clock_s=300.0)
    late[4]["tstamp"] = "1.0"

    laps, notes = read_laps(trace_csv(trace_rows(TRACK), short, late), "t.csv")

    assert [lap.number for lap in laps] == [0, 2]
    assert notes == [
        "t.csv: 1 episode has fewer than two rows and cannot be shown.",
        "t.csv: 1 row has a wrong clock and is left out.",
    ]


def test_a_lap_keeps_what_only_the_trace_knows():
    rows = trace_rows(TRACK, rows=3)
    rows[1]["all_wheels_on_track"], rows[1]["pause_duration"] = "False", "1.5"

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert lap.on_track == (True, False, True)
    assert lap.pause_s.tolist() == [0.0, 1.5, 0.0]
    assert lap.steps.tolist() == [1.0, 2.0, 3.0]


def test_objects_that_stand_still_are_recorded_once():
    [lap], _ = read_laps(trace_csv(trace_rows(TRACK, episode=3)), "lap.csv")
    recording = race(["box_obstacle"], RecordedObjects(3, [[[1.0, 2.0, 0.5]]]))

    found = lap.with_objects(recording)

    assert found.objects.shape == (31, 1, 3)
    assert (found.objects == [1.0, 2.0, 0.5]).all()


@pytest.mark.parametrize(
    "poses", [[], [[[1.0, 2.0]]], [[[1.0, 2.0, 0.5]], []], [[[1.0, float("inf"), 0.0]]]]
)
def test_objects_that_do_not_fit_are_not_shown(poses):
    [lap], _ = read_laps(trace_csv(trace_rows(TRACK, episode=3)), "lap.csv")

    found = lap.with_objects(race(["box_obstacle"], RecordedObjects(3, poses)))

    assert found.objects.shape == (31, 0, 3)


def race(shapes: list[str], *episodes: RecordedObjects) -> RaceRecording:
    return RaceRecording(
        "reinvent_base",
        False,
        "OBJECT_AVOIDANCE",
        "m",
        "1_Step-9",
        "Ada",
        "Red",
        shapes,
        list(episodes),
    )


def test_a_whole_lap_is_complete_even_where_the_simulator_did_not_say_so():
    rows = trace_rows(TRACK)
    rows[-1]["progress"] = "100.0"

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert lap.completed
    assert lap.status[-1] == "lap_complete"


@pytest.mark.parametrize(
    ("status", "clean", "end", "told"),
    [
        ({}, True, "Clean lap", "Clean lap: 2.07 s"),
        (
            {5: "off_track", 6: "pause", 7: "pause", 8: "pause"},
            False,
            "Finished, 1 reset",
            "Finished: 2.07 s = 1.87 driven + 0.20 penalty, 1 reset",
        ),
        ({5: "reversed"}, False, "Finished, 1 reset", "Finished: 2.07 s, 1 reset"),
        ({30: "off_track"}, False, "Off track", "Off track"),
    ],
)
def test_a_lap_with_a_reset_is_finished_and_not_clean(status, clean, end, told):
    rows = trace_rows(TRACK, status="lap_complete")
    for k, word in status.items():
        rows[k]["episode_status"] = word

    [lap], _ = read_laps(trace_csv(rows), "lap.csv")

    assert (lap.clean, lap.end, lap.told) == (clean, end, told)

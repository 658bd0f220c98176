"""Steps and laps from traces: ours, the reference's, logs, damaged files. Seed 003-05."""

from pathlib import Path

import pytest

from drcli.base.errors import SettingsError
from drcli.model.files.action_choice import complete_laps, read_steps

RUNS = Path(__file__).resolve().parents[5] / "shared" / "reference-runs"

HEADER = "episode,steps,X,Y,yaw,steer,throttle,action,reward,done,all_wheels_on_track,progress,"
HEADER += "closest_waypoint,track_len,tstamp,episode_status,pause_duration\n"


def line(episode=0, step=2, steer=0.0, speed=1.0, progress=0.0, time=0.0, status="in_progress"):
    return (
        f"{episode},{step},0.1,0.2,3.0,{steer},{speed},1,1.0,False,True,{progress},1,17.7,{time},"
        f"{status},0.0\n"
    )


def lap(episode=0, steps=50, pace_s=0.1, end="lap_complete", **changes) -> str:
    """A lap, from its prepare step on."""
    rows = [line(episode, 1, 30.0, 4.0, 0.2, 0.0, "prepare")]
    for k in range(1, steps + 1):
        status = end if k == steps else "in_progress"
        rows.append(
            line(
                episode, k + 1, progress=100 * k / steps, time=k * pace_s, status=status, **changes
            )
        )
    return "".join(rows)


def test_steps_are_read_and_standing_ones_are_not():
    text = HEADER + line(status="prepare") + line(steer=-12.5, speed=1.7) + line(status="pause")

    read = read_steps(text.encode(), "a.csv")

    assert [step.pair for step in read.steps] == [(-12.5, 1.7)]
    assert read.skipped == 0


def test_requests_beyond_the_car_are_cut_as_the_car_cuts_them():
    read = read_steps((HEADER + line(steer=45.0, speed=9.0) + line(speed=0.0)).encode(), "a.csv")

    assert [step.pair for step in read.steps] == [(30.0, 4.0), (0.0, 0.1)]


def test_columns_may_be_in_any_order_and_the_file_may_begin_with_a_mark():
    text = "\ufeffprogress,throttle,steer\n50,1.5,-3\n"

    assert read_steps(text.encode(), "a.csv").steps[0].pair == (-3.0, 1.5)


def test_lines_of_a_log_are_read():
    text = "10:02:03 INFO hello\nSIM_TRACE_LOG:" + line(steer=7.0) + "Reset agent\n"

    assert [step.pair for step in read_steps(text.encode(), "sim.log").steps] == [(7.0, 1.0)]


def test_damaged_lines_are_counted_and_skipped():
    good = line(steer=5.0)
    text = HEADER + good + "0,3,0.1\n" + good.replace("5.0", "nan") + good + good[:20]

    read = read_steps(text.encode() + b"\xff\x00", "a.csv")

    assert [step.pair[0] for step in read.steps] == [5.0, 5.0]
    assert read.skipped == 3


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"a,b\n1,2\n", b"\x89PNG\r\n\x1a\n\x00\x00", HEADER.encode()]
)
def test_what_is_no_trace_is_refused(content):
    with pytest.raises(SettingsError, match=r"a\.csv .*(trace|driven)"):
        read_steps(content, "a.csv")


def test_complete_laps_come_out_the_fastest_first():
    text = HEADER + lap(0, pace_s=0.1) + lap(1, end="off_track") + lap(2, pace_s=0.07)
    unfinished = lap(3).replace("lap_complete", "in_progress").replace(",100.0,", ",98.0,")

    laps = complete_laps([read_steps((text + unfinished).encode(), "a.csv")])

    assert [each.episode for each in laps] == [2, 0]
    assert laps[0].seconds == pytest.approx(49 * 0.07 + 1 / 15)
    assert len(laps[0].pairs) == 50


def test_each_lap_of_a_race_counts_and_one_with_a_penalty_does_not():
    several = lap(0) + lap(0, pace_s=0.09)
    middle = lap(0, steps=40).splitlines(keepends=True)
    middle[20] = middle[20].replace("in_progress", "crashed")

    laps = complete_laps([read_steps((HEADER + several + "".join(middle)).encode(), "a.csv")])

    assert len(laps) == 2


def test_a_trace_without_times_counts_steps():
    text = "episode,steer,throttle,progress,episode_status\n" + "".join(
        f"0,1,1,{k * 5},{'lap_complete' if k == 20 else 'in_progress'}\n" for k in range(1, 21)
    )

    (only,) = complete_laps([read_steps(text.encode(), "a.csv")])

    assert only.seconds == pytest.approx(20 / 15)


@pytest.mark.parametrize(
    ("run", "fastest_s"), [("drfc-time-trial", 12.2), ("simapp6-continuous", None)]
)
def test_recorded_runs_of_the_reference_are_read(run, fastest_s):
    folder = RUNS / run
    if not folder.is_dir():
        pytest.skip("The recorded runs of the reference are not here.")
    files = [read_steps(path.read_bytes(), path.name) for path in folder.rglob("*-iteration.csv")]

    laps = complete_laps(files)

    assert sum(file.skipped for file in files) == 0
    if fastest_s is not None:
        assert laps[0].seconds == pytest.approx(fastest_s, abs=0.1)

"""Fidelity: our car beside recorded drives, and the command that measures it."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drsim.car.car import CarBatch
from drsim.car.car_parameters import CAR_SETS, CarParameters
from drsim.fidelity.motion import compare_motion, compare_track_columns
from drsim.fidelity.recordings import RecordingError, load_recordings
from drsim.replay import main, summary
from drsim.track.worlds import load_track

SHARED = Path(__file__).resolve().parents[4] / "shared"

COLUMNS = [
    *("episode", "steps", "X", "Y", "yaw", "steer", "throttle", "action", "reward", "done"),
    *("all_wheels_on_track", "progress", "closest_waypoint", "track_len", "tstamp"),
    *("episode_status", "pause_duration"),
]


def drive(rows: int = 40, *, episode: int = 0, seed: int = 0, yaw_deg: float = 30.0):
    """Rows of an episode that our own car drove: a pose is the one its action starts from."""
    random = np.random.default_rng(seed)
    car = CarBatch(1, 1)
    car.place(np.array([0]), np.array([[3.0, 0.7, np.radians(yaw_deg)]]))
    trace = []
    for k in range(rows):
        steer, throttle = random.uniform([-25.0, 1.0], [25.0, 2.0])
        (x, y), yaw = car.front_xy[0], np.degrees(car.yaw_rad[0])
        status = "in_progress" if k else "prepare"
        trace.append(
            dict(
                zip(
                    COLUMNS,
                    [
                        episode,
                        k + 1.0,
                        x,
                        y,
                        yaw,
                        steer,
                        throttle,
                        f"[{steer} {throttle}]",
                        0.0,
                        False,
                        True,
                        1.0,
                        1,
                        17.7,
                        10.0 + episode * 100 + k / 15,
                        status,
                        0.0,
                    ],
                    strict=True,
                )
            )
        )
        if k:
            car.drive(np.array([steer]), np.array([throttle]))
    return trace


def text_of(rows, columns=COLUMNS) -> str:
    return "\n".join([",".join(columns), *(",".join(str(r[c]) for c in columns) for r in rows), ""])


def folder_with(tmp_path: Path, text: str, name: str = "0-iteration.csv") -> Path:
    file = tmp_path / "training-simtrace" / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")
    return tmp_path


def reference(run: str) -> Path:
    folder = SHARED / "reference-runs" / run
    if not folder.is_dir():
        pytest.skip("the reference recordings do not lie beside this checkout")
    return folder


def test_the_other_half_of_the_reference_drives_ends_within_the_bar():
    drives = load_recordings(reference("simapp6-continuous")).drives
    odd = [drive for drive in drives if drive.episode % 2]

    found = summary(compare_motion(odd))

    assert found["windows"] > 2500
    assert found["median_m"] < 0.12
    assert found["median_yaw_deg"] < 6.0
    assert found["driven_median_m"] == pytest.approx(1.56, abs=0.05)
    assert found["bicycle_median_m"] == pytest.approx(0.58, abs=0.06)
    assert found["bicycle_median_yaw_deg"] == pytest.approx(28.0, abs=3.0)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("car", "run", "bar_m", "bar_deg"),
    [
        ("release-6", "simapp6-continuous", 0.082, 4.0),
        ("low-grip", "simapp6-continuous", 0.09, 4.5),
        ("2022", "drfc-time-trial", 0.12, 7.0),
    ],
)
def test_each_car_follows_the_episodes_that_it_was_not_fitted_to(car, run, bar_m, bar_deg):
    drives = load_recordings(reference(run)).drives
    odd = [drive for drive in drives if drive.episode % 2]

    found = summary(compare_motion(odd, CAR_SETS[car].parameters))

    assert found["median_m"] < bar_m
    assert found["median_yaw_deg"] < bar_deg
    assert (
        fidelity_page()[car][run]
        == f"{found['median_m']:.3f} m, {found['median_yaw_deg']:.1f} degrees"
    )


def test_the_fidelity_page_has_a_row_for_every_car():
    assert list(fidelity_page()) == list(CAR_SETS)


def fidelity_page() -> dict[str, dict[str, str]]:
    """The errors of each car in the odd episodes, as the page has them."""
    text = (Path(__file__).resolve().parents[3] / "docs" / "fidelity.md").read_text("utf-8")
    table = text.split("| set | release 6, odd episodes |")[1].split("\n\n")[0]
    rows = [line.split(" | ") for line in table.splitlines()[2:]]
    return {
        row[0].split("`")[1]: {"simapp6-continuous": row[1], "drfc-time-trial": row[2]}
        for row in rows
    }


def test_a_drive_of_our_own_car_is_replayed_to_the_millimetre(tmp_path):
    folder = folder_with(tmp_path, text_of(drive()))

    windows = compare_motion(load_recordings(folder).drives)

    assert len(windows.position_m) > 15
    assert windows.position_m.max() < 0.002
    assert windows.yaw_deg.max() < 0.2


def test_a_car_with_other_parameters_does_not_pass_for_the_recorded_one(tmp_path):
    drives = load_recordings(folder_with(tmp_path, text_of(drive()))).drives

    lame = compare_motion(drives, replace(CarParameters(), steering_lag_s=0.3))

    assert np.median(lame.position_m) > 0.03


def test_a_put_back_in_the_middle_of_an_episode_is_no_motion(tmp_path):
    rows = drive(60)
    for k, row in enumerate(drive(40, seed=1, yaw_deg=-100.0), start=60):
        rows.append(row | {"steps": k + 1.0, "tstamp": 10.0 + k / 15})
        if rows[-1]["episode_status"] == "prepare":
            rows[-1]["episode_status"] = "pause"
    rows[59]["episode_status"] = "off_track"

    drives = load_recordings(folder_with(tmp_path, text_of(rows))).drives
    windows = compare_motion(drives)

    assert [len(d.poses) for d in drives] == [60, 40]
    assert windows.position_m.max() < 0.002


def test_a_lost_row_cuts_the_drive_and_the_next_windows_wait_for_the_lags_to_settle(tmp_path):
    rows = drive(80)
    del rows[30]

    drives = load_recordings(folder_with(tmp_path, text_of(rows))).drives
    windows = compare_motion(drives)

    assert [d.from_rest for d in drives] == [True, False]
    assert np.median(windows.position_m) < 0.05


def test_a_first_row_that_shows_the_end_of_the_last_episode_is_left_out(tmp_path):
    rows = drive()
    rows[0] |= {"X": -2.0, "Y": 2.0, "yaw": 170.0}

    drives = load_recordings(folder_with(tmp_path, text_of(rows))).drives

    assert [len(d.poses) for d in drives] == [1, 39]
    assert drives[1].from_rest
    assert compare_motion(drives).position_m.max() < 0.002


def test_the_simplest_old_trace_is_enough(tmp_path):
    columns = ["X", "Y", "yaw", "action", "tstamp", "steps"]

    drives = load_recordings(folder_with(tmp_path, text_of(drive(), columns))).drives

    assert drives[0].from_rest
    assert np.isnan(drives[0].progress).all()
    assert compare_motion(drives).position_m.max() < 0.002


def test_a_line_that_was_cut_off_is_left_out_and_counted(tmp_path):
    text = text_of(drive())

    recordings = load_recordings(folder_with(tmp_path, text[:-80]))

    assert recordings.left_out == 1
    assert len(recordings.drives[0].poses) == 39


def test_files_without_rows_are_passed_over(tmp_path):
    folder_with(tmp_path, "", "1-iteration.csv")
    folder_with(tmp_path, text_of([]), "2-iteration.csv")

    recordings = load_recordings(folder_with(tmp_path, text_of(drive())))

    assert len(recordings.drives) == 1


def test_every_other_episode_can_be_held_out(tmp_path, capsys):
    folder = folder_with(tmp_path, text_of(drive() + drive(60, episode=1)))
    windows = {}

    for half in ("all", "even", "odd"):
        main([str(folder), "--world", "reinvent_base", "--episodes", half, "--json"])
        windows[half] = json.loads(capsys.readouterr().out)["windows"]

    assert 0 < windows["even"] < windows["odd"]
    assert windows["all"] == windows["even"] + windows["odd"]


def test_the_report_is_one_json_object_with_the_promised_keys(tmp_path, capsys):
    folder = folder_with(tmp_path, text_of(drive()))

    code = main([str(folder), "--world", "reinvent_base", "--json"])

    found = json.loads(capsys.readouterr().out)
    promised = {"median_m", "p90_m", "median_yaw_deg", "windows", "bicycle_median_m"}
    assert code == 0
    assert promised <= set(found)
    assert found["track"]["rows"] == 40


def test_a_named_car_is_replayed_and_named(tmp_path, capsys):
    folder = folder_with(tmp_path, text_of(drive(60)))
    arguments = [str(folder), "--world", "reinvent_base"]

    assert main([*arguments, "--car", "2022", "--json"]) == 0
    old = json.loads(capsys.readouterr().out)
    assert main([*arguments, "--json"]) == 0
    default = json.loads(capsys.readouterr().out)

    assert old.pop("car") == "2022"
    assert old.keys() == default.keys()
    assert default["median_m"] < 0.002 < 0.05 < old["median_m"]
    assert old["track"] == default["track"]


def test_all_cars_are_replayed_one_below_the_other(tmp_path, capsys):
    folder = folder_with(tmp_path, text_of(drive(60)))
    arguments = [str(folder), "--world", "reinvent_base", "--car", "all"]

    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)

    names = [line.split()[0] for line in text.splitlines()[1:5]]
    assert names == [*CAR_SETS, "bicycle"]
    assert [car["car"] for car in report["cars"]] == list(CAR_SETS)
    assert report["cars"][0]["median_m"] < 0.002
    assert report["track"]["rows"] == 60


def test_an_unknown_car_is_refused_with_the_known_ones(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        main([str(tmp_path), "--world", "reinvent_base", "--car", "2023"])

    assert caught.value.code == 2
    printed = capsys.readouterr().err
    assert "2023" in printed
    assert "low-grip" in printed


def test_a_world_whose_route_is_not_here_costs_only_its_own_lines(tmp_path, capsys):
    folder = folder_with(tmp_path, text_of(drive()))

    code = main([str(folder), "--world", "Nowhere_track", "--json"])

    printed = capsys.readouterr()
    assert code == 0
    assert json.loads(printed.out)["track"] is None
    assert "There is no track 'Nowhere_track' here" in printed.err


def test_a_world_that_the_recording_was_not_driven_on_is_told(tmp_path, capsys):
    rows = [row | {"track_len": 60.0} for row in drive()]

    main([str(folder_with(tmp_path, text_of(rows))), "--world", "reinvent_base"])

    assert "does not fit reinvent_base" in capsys.readouterr().err


def test_a_recording_of_the_other_direction_is_recognised(tmp_path):
    track = load_track("reinvent_base").reversed()
    poses = track.pose_at(np.linspace(0.1, 5.0, 40))
    where = track.locate(poses[:, :2])
    rows = [
        row | {"X": x, "Y": y, "yaw": np.degrees(yaw), "closest_waypoint": waypoint}
        for row, (x, y, yaw), waypoint in zip(drive(), poses, where.nearest, strict=True)
    ]

    found = compare_track_columns(
        load_recordings(folder_with(tmp_path, text_of(rows))).drives, load_track("reinvent_base")
    )

    assert found.reverse
    assert found.closest_waypoint == 1.0


@pytest.mark.parametrize(
    ("text", "arguments", "sentence"),
    [
        (None, [], "holds no"),
        ("", [], "No simtrace in"),
        ("a,b\n1,2\n", [], "has no column X, Y, yaw, tstamp, steer, throttle"),
        (text_of([]), [], "No simtrace in"),
        ("X,Y,yaw,steer,throttle,tstamp\n1,2,3,4,5,6\n", [], "goes on for 1 s"),
        ("X,Y,yaw,action,tstamp\n1,2,3,7,6\n", [], "No simtrace in"),
        ("\x00\x01\x02\n\xff\n", [], "has no column"),
        (text_of(drive(4)), ["--horizon", "nan"], "--horizon is nan"),
        (text_of(drive(4)), ["--horizon", "1e9"], "0.1 to 60 s"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_a_sentence(
    tmp_path, capsys, text, arguments, sentence
):
    folder = tmp_path if text is None else folder_with(tmp_path, text)

    code = main([str(folder), "--world", "reinvent_base", *arguments])

    printed = capsys.readouterr()
    assert code == 3
    assert sentence in printed.err
    assert "Traceback" not in printed.err
    assert not printed.out


def test_a_folder_that_does_not_exist_is_refused():
    with pytest.raises(RecordingError, match="does not exist"):
        load_recordings(Path("nowhere"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read_is_refused(tmp_path):
    folder = folder_with(tmp_path, text_of(drive(4)))
    (folder / "training-simtrace" / "0-iteration.csv").chmod(0)

    with pytest.raises(RecordingError, match="cannot be read"):
        load_recordings(folder)


@settings(max_examples=60)
@given(at=st.integers(0, 4000), bytes_=st.binary(max_size=40))
def test_no_damage_to_a_trace_breaks_the_reader(tmp_path_factory, at, bytes_):
    file = tmp_path_factory.mktemp("damaged") / "0-iteration.csv"
    whole = text_of(drive(20)).encode()
    file.write_bytes(whole[:at] + bytes_ + whole[at + len(bytes_) :])

    try:
        drives = load_recordings(file).drives
    except RecordingError:
        drives = []

    assert all(np.isfinite(drive.poses).all() for drive in drives)
    assert all(np.isfinite(drive.ends_s).all() for drive in drives)

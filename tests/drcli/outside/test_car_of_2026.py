"""`dr-car config`, `check`, `latency` and the IMU's stop, against a car with software 2.3.0."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rosbags.rosbag2 import StoragePlugin

from car_bags import OLD_SERVO, record
from drcli.outside.car import car_camera
from drcli.outside.car.car_camera import way_up
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.track.worlds import load_track
from fake_car import archive, software_of_2026


@pytest.fixture
def car(logged_in):
    """A car with the IMU, and a model loaded."""
    logged_in.car.__dict__.update(software_of_2026(), state="loaded")
    return logged_in


def printed(capsys):
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def value(capsys, name):
    return next(each["value"] for each in printed(capsys)["settings"] if each["name"] == name)


# Settings.


def test_settings_are_shown_with_what_the_car_offers(car, capsys):
    assert car("config", "--json") == 0

    found = {each["name"]: each for each in printed(capsys)["settings"]}
    assert found["camera.orientation"]["choices"] == [0, 180]
    assert found["camera.mode"]["choices"] == ["auto", "legacy", "modern"]
    assert found["camera.enable_gray_overlay"]["choices"] == [False, True]
    assert (found["steering.mode"]["value"], found["steering.mode"]["choices"]) == (
        "servo",
        ["servo"],
    )
    assert car("config") == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["camera.enable_gray_overlay", "false", "false,", "true"] in lines


def test_only_what_was_named_is_sent_and_kept(car, capsys):
    car.car.config["camera"]["mode"] = "modern"

    code = car(
        "config",
        *("camera.orientation=180", "camera.enable_gray_overlay=True", "imu.crash_threshold_g=2"),
        *("imu.enabled=true", "logging.mode=never", "--json"),
    )

    assert code == 0
    assert printed(capsys)["changed"] == [
        *("camera.orientation", "camera.enable_gray_overlay", "imu.crash_threshold_g"),
        *("imu.enabled", "logging.mode"),
    ]
    kept = car.car.config
    assert kept["camera"] == {"mode": "modern", "orientation": 180, "enable_gray_overlay": True}
    assert kept["imu"]["crash_enabled"] is True
    assert kept["logging"]["mode"] == "Never"
    assert car("config", "camera.orientation=0") == 0
    assert "applies this when it starts next" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("camera.orientation", "is not a setting with a value"),
        ("camera.orientatoin=180", "Did you mean camera.orientation?"),
        ("camera.orientation=90", "Choose from: 0, 180."),
        ("camera.orientation=true", "Choose from: 0, 180."),
        ("camera.enable_gray_overlay=1", "Choose from: false, true."),
        ("steering.mode=diffdrive", "Choose from: servo."),
        ("imu.crash_threshold_g=9", "Choose from: 0.0, 1.5, 2.0, 2.5, 3.0."),
        ("imu.crash_enabled=true", "Set imu.crash_threshold_g; 0 switches it off."),
    ],
)
def test_what_the_car_does_not_offer_is_not_sent(car, text, sentence, capsys):
    before = json.dumps(car.car.config)

    assert car("config", text) == 3
    assert sentence in " ".join(capsys.readouterr().err.split())
    assert json.dumps(car.car.config) == before
    assert not [line for line in car.car.requests if line.startswith("POST")]


def test_a_car_without_the_sensor_has_a_differential_drive_and_no_imu(car, capsys):
    car.car.__dict__.update(software_of_2026(imu=False))

    assert car("config", "steering.mode=diffdrive") == 0
    assert car.car.config["steering"]["mode"] == "diffdrive"
    assert car("config", "imu.enabled=true") == 3
    assert "Choose from: false." in capsys.readouterr().err


def test_what_the_car_refuses_or_does_not_keep_is_a_sentence(car, monkeypatch, capsys):
    car.car.refusals["/api/car_config"] = "Disk full"
    assert car("config") == 4
    assert "did not tell its settings: Disk full" in capsys.readouterr().err

    car.car.refusals.clear()
    monkeypatch.setattr(car.car, "_configure", lambda *_: _success(), raising=False)
    assert car("config", "camera.orientation=180") == 4
    assert "has not kept camera.orientation=180; it says 0" in capsys.readouterr().err


def _success():
    from werkzeug import Response

    return Response('{"success": true}', content_type="application/json")


def test_older_software_has_no_settings(car, capsys):
    car.car.config = None

    assert car("config") == 4
    assert "version 2.3.0 or later" in capsys.readouterr().err
    assert car("status", "--json") == 0
    assert printed(capsys)["settings"] == {}
    assert car("status") == 0
    assert "IMU" not in capsys.readouterr().out


def test_the_status_tells_steering_picture_and_when_the_imu_stops(car, capsys):
    assert car("status") == 0
    out = capsys.readouterr().out
    assert "auto, turned by 0 degrees, gray overlay off" in out
    assert "never" in out

    car("config", "imu.enabled=true", "imu.pickup_threshold_g=0.75", "camera.orientation=180")
    capsys.readouterr()
    assert car("status") == 0
    out = capsys.readouterr().out
    assert "turned by 180 degrees" in out
    assert "at a pickup (0.75 g)" in out
    assert "crash" not in out


# The IMU's stop.


@pytest.mark.parametrize("reason", ["crash", "pickup"])
def test_a_stop_of_the_imu_ends_the_drive_and_says_why(car, reason, capsys):
    car.car.events.put(("imu_stop", reason))

    assert car("start", "-f", "--seconds", "60") == 0

    printed_ = capsys.readouterr()
    assert f"its IMU noticed a {reason}" in printed_.out
    assert "dr-car start" in printed_.err
    assert not car.car.driving
    assert car.car.requests[-1] == "PUT /api/start_stop"


def test_other_events_do_not_end_a_drive(car, capsys):
    car.car.events.put(("battery", "low"))

    assert car("start", "-f", "--seconds", "0.2", "--json") == 0

    report = printed(capsys)
    assert (report["imu_stop"], report["interrupted"]) == ("", False)
    assert report["seconds"] >= 0.2


# The camera.


@pytest.fixture(scope="module")
def pictures():
    """What 40 cars see on two tracks. Shape (40, 120, 160)."""
    found = []
    for name in ("reinvent_base", "willow"):
        simulation = Simulation(load_track(name), num_cars=20, reward_function=centre_line_reward)
        simulation.reset(np.arange(20), np.arange(20) / 20)
        found.append(simulation.frames[:, 0].copy())
        simulation.close()
    return np.concatenate(found)


def jpeg(picture: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(picture).convert("RGB").resize((640, 480)).save(out, "JPEG", quality=95)
    return out.getvalue()


def test_simulated_pictures_are_never_taken_for_turned_ones(pictures):
    ways = [way_up(jpeg(picture)) for picture in pictures]
    turned = [way_up(jpeg(picture[::-1, ::-1])) for picture in pictures]

    assert "upside down" not in ways
    assert "upright" not in turned
    assert ways.count("upright") >= 36
    assert turned.count("upside down") >= 36


def test_a_picture_that_shows_nothing_is_unknown_and_no_picture_a_sentence():
    assert way_up(jpeg(np.full((120, 160), 90, np.uint8))) == "unknown"
    with pytest.raises(car_camera.CarError, match="is not a picture"):
        way_up(b"\xff\xd8\xffnothing\xff\xd9")


def test_an_upright_picture_is_kept_and_fits(car, pictures, tmp_path, capsys):
    car.car.picture = jpeg(pictures[3])

    assert car("check", "-o", str(tmp_path), "--json") == 0

    report = printed(capsys)
    assert report["picture"] == str(tmp_path / "car-picture.jpg")
    assert (report["way"], report["orientation"], report["gray_overlay"]) == ("upright", 0, False)
    assert report["problems"] == []
    assert Path(report["picture"]).read_bytes() == car.car.picture


@pytest.mark.parametrize(
    ("camera", "remedy"),
    [
        ({"mode": "modern"}, "`dr-car config camera.orientation=180`, and restart the car."),
        ({"mode": "modern", "orientation": 180}, "`dr-car config camera.orientation=0`"),
        ({"mode": "auto"}, "auto takes on a Raspberry Pi only"),
        ({"mode": "legacy"}, "cars turn pictures only with camera.mode=modern"),
        ({"orientations": [0]}, "this car cannot turn its picture"),
        (None, "this car cannot turn its picture"),
    ],
)
def test_a_picture_upside_down_is_warned_of_with_what_helps_this_car(
    car, pictures, camera, remedy, capsys
):
    car.car.picture = jpeg(pictures[3][::-1, ::-1])
    if camera is None:
        car.car.config = None
    else:
        car.car.offers["camera_orientations"] = camera.pop("orientations", [0, 180])
        car.car.config["camera"].update(camera)

    assert car("check", "-o", "seen.jpg") == 0

    told = capsys.readouterr()
    warning = " ".join(told.err.split())
    assert "The picture looks upside down. Look at seen.jpg: the road must be" in warning
    assert remedy in warning
    assert "looks upside down" in told.out


def test_an_orientation_without_effect_is_told(car, pictures, capsys):
    car.car.picture = jpeg(pictures[3])
    car.car.config["camera"].update(mode="legacy", orientation=180)

    assert car("check") == 0
    assert "camera.orientation=180 has no effect" in capsys.readouterr().err


@pytest.mark.parametrize("overlay", [True, False])
def test_a_model_is_checked_under_the_overlay_if_the_car_lays_it(
    car, pictures, overlay, tmp_path, capsys
):
    car.car.picture = jpeg(pictures[3])
    car.car.config["camera"]["enable_gray_overlay"] = overlay
    file = archive(tmp_path / "model.tar.gz")

    assert car("check", str(file)) == 0

    told = capsys.readouterr()
    assert ("With the gray overlay of the car's camera" in told.err) is overlay
    assert f"The gray overlay is {'on' if overlay else 'off'}." in told.out


def test_a_camera_that_sends_nothing_and_a_file_that_exists_are_sentences(car, capsys):
    assert car("check") == 4
    assert "show its camera" in capsys.readouterr().err
    Path("car-picture.jpg").write_text("an older one")
    assert car("check") == 3
    assert "-f (--force)" in capsys.readouterr().err


def test_a_stream_without_a_picture_is_a_sentence(car, monkeypatch, capsys):
    monkeypatch.setattr(car_camera, "_LARGEST", 50_000)
    car.car.picture = b"no picture"

    assert car("check") == 4
    assert "sent no picture" in capsys.readouterr().err


# Latency.


def test_the_latency_that_the_car_measured_becomes_settings(car, working_folder, capsys):
    car.car.status = {"latency_mean": 41.6, "latency_p95": 55.2, "fps_mean": 29.94}

    assert car("latency", "--json") == 0
    report = printed(capsys)
    assert report["settings"] == {
        "DR_SIM_LATENCY": "0.042",
        "DR_SIM_LATENCY_JITTER": "0.014",
    }
    assert (report["until"], report["frames_per_s"], report["written"]) == ("servo", 29.94, "")
    assert "DR_SIM_LATENCY" not in (working_folder / "run.env").read_text()

    assert car("latency", "--write") == 0
    assert "42 ms from picture to servo, 55 ms in the slowest of 20" in capsys.readouterr().out
    text = (working_folder / "run.env").read_text()
    assert "DR_SIM_LATENCY=0.042" in text
    assert "DR_SIM_LATENCY_JITTER=0.014" in text


@pytest.mark.parametrize("community", [True, False])
def test_a_car_that_has_measured_no_latency_is_told_what_to_do(car, community, capsys):
    car.car.community = community

    assert car("latency") == 3
    assert "has measured no latency" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("storage", "embedded"),
    [(StoragePlugin.MCAP, True), (StoragePlugin.SQLITE3, True), (StoragePlugin.SQLITE3, False)],
)
def test_a_recording_tells_how_late_its_actions_are(dr, tmp_path, storage, embedded, capsys):
    late_ms = [30.0] * 90 + [60.0] * 10 + [9000.0, -3.0]
    bag = record(tmp_path / "model-20260605-101112", late_ms, storage=storage, embedded=embedded)

    assert dr("car", "latency", str(bag), "--json") == 0

    report = printed(capsys)
    assert (report["until"], report["actions"]) == ("action", 100)
    assert report["settings"] == {
        "DR_SIM_LATENCY": "0.030",
        "DR_SIM_LATENCY_JITTER": "0.030",
    }
    assert report["frames_per_s"] == pytest.approx(30.3, abs=0.1)


def test_recordings_below_a_folder_count_together_and_the_servo_is_preferred(
    dr, tmp_path, working_folder, capsys
):
    record(tmp_path / "logs" / "a", [30.0] * 5, status=[(0.0, 0.0), (40.0, 50.0)])
    record(tmp_path / "logs" / "b", [30.0] * 5, status=[(44.0, 54.0)])

    assert dr("car", "latency", str(tmp_path / "logs"), "-w") == 0

    assert "42 ms from picture to servo, 52 ms" in capsys.readouterr().out
    assert "DR_SIM_LATENCY=0.042" in (working_folder / "run.env").read_text()


def test_what_is_no_recording_with_latency_is_a_sentence(dr, tmp_path, capsys):
    assert dr("car", "latency", str(tmp_path)) == 3
    assert "no metadata.yaml" in capsys.readouterr().err

    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5")
    assert dr("car", "latency", str(tmp_path / "torn")) == 3
    assert "cannot be read as a recording" in capsys.readouterr().err

    for name, embedded in (("old", True), ("older", False)):
        bag = record(tmp_path / name, [30.0], layouts=OLD_SERVO, embedded=embedded)
        assert dr("car", "latency", str(bag)) == 3
        assert "2.1.7" in capsys.readouterr().err


def test_without_the_library_the_extra_is_named(dr, tmp_path, monkeypatch, capsys):
    bag = record(tmp_path / "bag", [30.0])
    monkeypatch.setattr("drcli.base.installation.util.find_spec", lambda name: None)

    assert dr("car", "latency", str(bag)) == 7
    assert 'pip install "drcli[bags]"' in capsys.readouterr().err

"""`dr-car` against a car that keeps the rules of a real one."""

import json
import os
import signal
import stat
import threading
from pathlib import Path

import pytest

from drcli.outside.car import car_driving, car_models, car_web
from drcli.outside.car.car_address import CarAddress, load_login, login_file
from fake_car import PASSWORD, FakeCar, Installed, archive, graph, make_certificate, served

METADATA = {"sensor": ["FRONT_FACING_CAMERA"]}


def printed(capsys):
    return json.loads(capsys.readouterr().out.splitlines()[-1])


# Login.


def test_a_login_keeps_cookies_that_only_this_user_can_read_and_no_password(garage, monkeypatch):
    monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)

    assert garage("login") == 0

    path = login_file(CarAddress("127.0.0.1", garage.port))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert PASSWORD not in path.read_text()
    assert json.loads(path.read_text())["cookies"]["deepracer_token"] in garage.car.tokens


def test_a_wrong_password_is_told_and_keeps_no_login(garage, monkeypatch, capsys):
    monkeypatch.setenv("DR_CAR_PASSWORD", "wrong")

    assert garage("login") == 3
    assert "does not accept the password" in capsys.readouterr().err
    assert garage("list") == 3
    assert "There is no login at the car" in capsys.readouterr().err


def test_the_password_may_be_in_a_file_or_come_through_a_pipe(garage, tmp_path, monkeypatch):
    (tmp_path / "password.txt").write_text(f"{PASSWORD}\nsecond line\n")
    assert garage("login", "--password-file", str(tmp_path / "password.txt")) == 0

    with (tmp_path / "password.txt").open() as pipe:
        monkeypatch.setattr("sys.stdin", pipe)
        assert garage("login", "--password-file", "-") == 0


@pytest.mark.parametrize("content", [None, b"", b"\n", b"\xff\xfe"])
def test_a_password_file_that_has_none_is_a_sentence(garage, tmp_path, content, capsys):
    path = tmp_path / "password.txt"
    if content is not None:
        path.write_bytes(content)

    assert garage("login", "--password-file", str(path)) == 3
    assert "--password-file" in capsys.readouterr().err


def test_on_a_terminal_the_password_is_asked_for_without_echo(garage, monkeypatch):
    asked = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("getpass.getpass", lambda prompt: asked.append(prompt) or PASSWORD)

    assert garage("login") == 0
    assert asked == [f"Password of the car {garage.address}: "]


def test_without_a_terminal_nobody_waits_for_a_password(garage, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)

    assert garage("login") == 3
    assert "--password-file" in capsys.readouterr().err


def test_a_car_with_another_certificate_gets_neither_password_nor_cookie(
    logged_in, tmp_path, monkeypatch, capsys, dr
):
    login = load_login(CarAddress("127.0.0.1", logged_in.port))
    other = FakeCar()
    with served(other, make_certificate(tmp_path, "other")) as port:
        address = CarAddress("127.0.0.1", port)
        car_web.save_login(address, login)
        monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)

        assert dr("car", "list", "--car", address.place) == 4
        assert "shows another certificate" in capsys.readouterr().err
        assert dr("car", "login", "--car", address.place) == 4
        assert other.requests == []

        assert dr("car", "login", "--new-certificate", "--car", address.place) == 0
        assert dr("car", "list", "--car", address.place) == 0


def test_a_login_may_trust_an_authority_or_nothing(
    garage, certificate, monkeypatch, tmp_path, capsys
):
    monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)
    foreign, _ = make_certificate(tmp_path, "foreign")

    assert garage("login", "--ca", str(certificate[0])) == 0
    assert garage("list") == 0
    assert garage("login", "--ca", str(foreign)) == 4
    assert "certificate of the car" in capsys.readouterr().err
    assert garage("login", "--insecure") == 0
    assert "can pose as the car" in capsys.readouterr().err
    assert garage("list") == 0


def test_a_file_without_certificates_is_refused(garage, tmp_path, capsys):
    (tmp_path / "ca.pem").write_text("nothing")

    assert garage("login", "--ca", str(tmp_path / "ca.pem")) == 3
    assert garage("login", "--ca", str(tmp_path / "none.pem")) == 3
    assert garage("login", "--insecure", "--new-certificate") == 2


def test_after_a_logout_a_login_is_needed_and_the_certificate_is_still_known(logged_in, capsys):
    assert logged_in("logout") == 0
    assert logged_in("logout") == 0
    assert logged_in("list") == 3
    assert load_login(CarAddress("127.0.0.1", logged_in.port)).fingerprint


def test_a_login_that_has_expired_says_so(logged_in, capsys):
    logged_in.car.tokens.clear()

    assert logged_in("list") == 3
    assert "does not accept the login any more" in capsys.readouterr().err


def test_a_token_that_has_expired_is_read_again_and_kept(logged_in):
    logged_in.car.csrf = dict.fromkeys(logged_in.car.csrf, "new")

    assert logged_in("speed", "30") == 0
    assert logged_in.car.requests == [
        "PUT /api/max_nav_throttle",
        "GET /",
        "PUT /api/max_nav_throttle",
    ]
    logged_in.car.requests.clear()
    assert logged_in("speed", "40") == 0
    assert logged_in.car.requests == ["PUT /api/max_nav_throttle"]


def test_a_car_that_refuses_its_own_token_is_one_sentence(logged_in, capsys):
    logged_in.car.failures["/api/max_nav_throttle"] = [400, 400]

    assert logged_in("speed", "30") == 4
    assert "refuses the token (CSRF)" in capsys.readouterr().err


# The connection.


def test_nothing_at_the_address_is_a_sentence(dr, garage, monkeypatch, capsys):
    monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)

    assert dr("car", "login", "--car", "127.0.0.1:9") == 4
    assert "127.0.0.1:9 refuses connections" in capsys.readouterr().err
    assert dr("car", "login", "--car", "no-such-car.invalid") == 4
    assert "There is no host called no-such-car.invalid" in capsys.readouterr().err


def test_a_page_without_tls_and_one_of_another_program_are_sentences(
    dr, garage, certificate, monkeypatch, capsys
):
    monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)
    with served(FakeCar(), None) as port:
        assert dr("car", "login", "--car", f"127.0.0.1:{port}") == 4
    assert "does not speak https" in capsys.readouterr().err

    garage.car.failures["/"] = [404]
    assert garage("login") == 4
    assert "is not that of a DeepRacer car" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("status", "sentence"),
    [
        (404, "Update the software"),
        (413, "larger than the car"),
        (500, "does not work now (answer 500)"),
        (502, "does not work now (answer 502)"),
        (504, "took too long"),
        (200, "not JSON"),
        (302, "does not accept the login any more"),
        (418, "answered 418"),
    ],
)
def test_every_answer_that_is_no_success_is_one_sentence(logged_in, status, sentence, capsys):
    logged_in.car.failures["/api/models"] = [status]

    code = logged_in("list")

    said = capsys.readouterr().err
    assert code == (3 if status == 302 else 4)
    assert sentence in said
    assert "Traceback" not in said


def test_a_car_that_does_not_answer_is_a_sentence(logged_in, monkeypatch, capsys):
    held = threading.Event()
    logged_in.car.hook = lambda path: held.wait(5) and None
    monkeypatch.setattr(car_web.CarWeb.get, "__kwdefaults__", {"timeout_s": 0.05})

    assert logged_in("list") == 4
    held.set()
    assert "did not answer within 0.05 s" in capsys.readouterr().err


def test_a_car_needs_no_working_folder_but_a_name(dr, garage, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    assert dr("car", "list") == 3
    assert "Give its address with --car" in capsys.readouterr().err
    assert dr("car", "list", "--car", "10.0.0.5") == 3
    assert "`dr-car login --car 10.0.0.5`" in capsys.readouterr().err


@pytest.mark.parametrize(
    "address", ["http://car", "car:0", "car:99999", "user@car", "a b", "car/models", "[::1", "-"]
)
def test_what_is_no_address_is_refused(dr, garage, address, capsys):
    assert dr("car", "list", "--car", address) == 3
    assert "--car" in capsys.readouterr().err


def test_the_address_comes_from_option_environment_or_file(
    dr, logged_in, working_folder, monkeypatch, capsys
):
    assert dr("car", "list") == 3
    assert "No car is named" in capsys.readouterr().err

    with (working_folder / "system.env").open("a") as file:
        file.write(f"DR_CAR_ADDRESS=https://{logged_in.address}/\n")
    assert dr("car", "list") == 0

    (working_folder / "run.env").write_text("DR_WORKERS=many\n")
    monkeypatch.setenv("DR_CAR_ADDRESS", logged_in.address)
    assert dr("car", "stop") == 0, "a mistake in the settings must not prevent a stop"


# Models.


def test_an_upload_waits_until_the_car_lists_the_model(logged_in, tmp_path, capsys):
    path = archive(tmp_path / "fast.tar.gz")

    assert logged_in("upload", str(path), "--json") == 0

    told = capsys.readouterr()
    report = json.loads(told.out)
    assert told.err.endswith(f"    dr-car load fast --car {logged_in.address}\n")
    assert (report["model"], report["usable"]) == ("fast", True)
    assert report["size_bytes"] == path.stat().st_size
    assert logged_in.car.models["fast"].metadata


def test_a_file_that_the_car_would_refuse_is_not_sent(logged_in, tmp_path):
    path = archive(tmp_path / "fast.tar.gz", files={"checkpoint": b"x"})

    assert logged_in("upload", str(path)) == 3
    assert logged_in.car.requests == []


def test_an_installation_that_the_car_reports_as_failed_may_still_finish(
    logged_in, tmp_path, capsys
):
    logged_in.car.looks_left = 4

    assert logged_in("upload", str(archive(tmp_path / "fast.tar.gz"))) == 0
    assert "has not confirmed" in capsys.readouterr().err


def test_an_installation_whose_answer_is_lost_may_still_finish(logged_in, tmp_path):
    logged_in.car.models["fast"] = Installed(METADATA)
    logged_in.car.failures["/api/uploadModels"] = [504]

    assert logged_in("upload", "-f", str(archive(tmp_path / "fast.tar.gz"))) == 0


def test_an_upload_that_the_car_refuses_with_status_200_is_a_failure(
    logged_in, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(car_models, "LISTED_WITHIN_S", 0.05)
    assert logged_in("upload", str(archive(tmp_path / "a.tar.gz"))) == 0
    same = {"agent/model.pb": graph("a.tar.gz")}

    assert logged_in("upload", str(archive(tmp_path / "b.tar.gz", files=same))) == 4

    said = capsys.readouterr().err
    assert "Failed to upload & optimize the model, and b is not in its list" in said
    assert "same content under another name" in said.replace("\n", " ")


def test_an_upload_that_is_accepted_and_never_listed_is_a_failure(
    logged_in, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(car_models, "LISTED_WITHIN_S", 0.05)
    logged_in.car.forgets = True

    assert logged_in("upload", str(archive(tmp_path / "a.tar.gz"))) == 4
    assert "has accepted a, but does not list it" in capsys.readouterr().err


def test_a_model_of_the_same_name_is_replaced_after_a_question(
    logged_in, tmp_path, monkeypatch, capsys
):
    path = archive(tmp_path / "fast.tar.gz")
    assert logged_in("upload", str(path)) == 0
    monkeypatch.setattr("drcli.cli.prompts._line_in_pipe", lambda: "n\n")

    assert logged_in("upload", str(path)) == 1
    assert "already has fast. Replace it? [y/N]" in capsys.readouterr().err
    assert logged_in("upload", "-f", str(path)) == 0


def test_a_model_whose_sensor_is_missing_is_installed_and_said_to_be_of_no_use(
    logged_in, tmp_path, capsys
):
    path = archive(tmp_path / "stereo.tar.gz", metadata={"sensor": ["STEREO_CAMERAS"]})

    assert logged_in("upload", str(path)) == 0
    assert "its sensor (Stereo camera) is not connected" in capsys.readouterr().err
    assert logged_in("load", "stereo") == 3
    assert "its sensor (Stereo camera) is not connected" in capsys.readouterr().err
    assert "PUT /api/models/stereo/model" not in logged_in.car.requests


def test_the_list_has_usable_disabled_and_broken_models(logged_in, capsys):
    logged_in.car.models = {
        "broken": Installed(None),
        "scan": Installed({"sensor": ["LIDAR"]}),
        "fast": Installed(METADATA),
    }

    assert logged_in("list", "--json") == 0
    found = {model["name"]: model for model in printed(capsys)["models"]}
    assert [model["usable"] for model in found.values()] == [True, False, False]
    assert list(found) == ["fast", "scan", "broken"]
    assert found["fast"]["size"] == "12M"
    assert logged_in("list") == 0
    assert "it has no model file" in capsys.readouterr().out


@pytest.mark.parametrize("answer", [[], {"models": 3}, {}])
def test_a_list_of_another_form_is_a_sentence(logged_in, monkeypatch, answer, capsys):
    monkeypatch.setattr(FakeCar, "_list", lambda self: __import__("fake_car")._json(answer))

    assert logged_in("list") == 4
    assert "not a list of models" in capsys.readouterr().err


def test_a_load_waits_until_the_car_has_loaded_the_model(logged_in, capsys):
    logged_in.car.models["fast"] = Installed(METADATA)

    assert logged_in("load", "fast", "--json") == 0

    report = printed(capsys)
    assert report["model"] == "fast"
    assert 0.0 < report["seconds"] < 60.0
    assert logged_in.car.state == "loaded"
    assert logged_in.car.requests.count("GET /api/isModelLoading") == 3


def test_a_load_that_is_answered_as_a_success_and_then_fails_is_a_failure(logged_in, capsys):
    logged_in.car.models["fast"] = Installed(METADATA)
    logged_in.car.load_ends = "error"

    assert logged_in("load", "fast") == 4
    assert "has not loaded fast: its state is error" in capsys.readouterr().err


def test_a_load_that_never_ends_is_a_failure(logged_in, monkeypatch, capsys):
    monkeypatch.setattr(car_models, "LOADED_WITHIN_S", 0.05)
    logged_in.car.models["fast"] = Installed(METADATA)
    logged_in.car.load_polls = 1_000_000

    assert logged_in("load", "fast") == 4
    assert "has not loaded fast in time" in capsys.readouterr().err


def test_a_load_that_the_car_refuses_gives_its_reason(logged_in, capsys):
    logged_in.car.models["fast"] = Installed(METADATA)
    logged_in.car.refusals["/api/models/fast/model"] = "Incorrect values in model_metadata.json"

    assert logged_in("load", "fast") == 4
    assert "fast: Incorrect values in model_metadata.json." in capsys.readouterr().err


def test_a_model_that_is_not_there_names_a_similar_one(logged_in, capsys):
    logged_in.car.models["fast-car-1"] = Installed(METADATA)

    assert logged_in("load", "fast-car") == 3
    assert "Did you mean fast-car-1?" in capsys.readouterr().err


# Driving.


@pytest.fixture
def ready(logged_in):
    """A car with a loaded model."""
    logged_in.car.models["fast"] = Installed(METADATA)
    logged_in.car.state = "loaded"
    return logged_in


def test_a_drive_of_some_seconds_ends_with_a_stop(ready, capsys):
    seen = []
    ready.car.hook = lambda path: seen.append(ready.car.driving)

    assert ready("start", "-f", "--seconds", "0.1", "--speed", "30", "--json") == 0

    report = printed(capsys)
    assert (report["driving"], report["interrupted"]) == (False, False)
    assert report["seconds"] >= 0.1
    assert ready.car.requests[-4:] == [
        "PUT /api/max_nav_throttle",
        "PUT /api/drive_mode",
        "PUT /api/start_stop",
        "PUT /api/start_stop",
    ]
    assert any(seen)
    assert not ready.car.driving
    assert ready.car.throttle == 30


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_the_car(ready, number, monkeypatch, capsys):
    monkeypatch.setattr(car_driving, "WATCH_S", 0.01)
    looked = []

    def hook(path):
        if path == "/api/get_battery_level":
            looked.append(ready.car.driving)
            os.kill(os.getpid(), number)

    ready.car.hook = hook

    assert ready("start", "-f") == 130
    assert looked[0]
    assert not ready.car.driving
    assert "has stopped" in capsys.readouterr().out


def test_ctrl_c_while_the_start_is_under_way_stops_the_car(ready):
    def hook(path):
        if path == "/api/start_stop" and len(ready.car.requests) < 5:
            os.kill(os.getpid(), signal.SIGINT)

    ready.car.hook = hook

    assert ready("start", "-f") == 130
    assert ready.car.requests[-1] == "PUT /api/start_stop"
    assert not ready.car.driving


def test_a_second_ctrl_c_does_not_prevent_the_stop(ready):
    def hook(path):
        if path == "/api/start_stop" and ready.car.driving:
            os.kill(os.getpid(), signal.SIGINT)

    ready.car.hook = hook

    assert ready("start", "-f", "--seconds", "0.1") == 130
    assert not ready.car.driving


def test_a_start_without_an_answer_stops_the_car(ready, capsys):
    ready.car.failures["/api/start_stop"] = [504]

    assert ready("start", "-f") == 4
    assert ready.car.requests[-1] == "PUT /api/start_stop"
    assert not ready.car.driving
    assert "took too long" in capsys.readouterr().err


def test_a_car_that_cannot_be_reached_while_it_drives_is_a_warning(ready, monkeypatch, capsys):
    monkeypatch.setattr(car_driving, "WATCH_S", 0.01)
    ready.car.failures["/api/get_battery_level"] = [502, 502, 502]

    assert ready("start", "-f", "--seconds", "0.2") == 0
    assert capsys.readouterr().err.count("The car may not stop when asked to") == 1


def test_detached_the_car_drives_on_until_it_is_stopped(ready, capsys):
    assert ready("start", "-f", "--detach") == 0
    assert ready.car.driving
    assert "dr-car stop" in capsys.readouterr().err

    assert ready("stop") == 0
    assert not ready.car.driving
    assert ready("start", "-f", "--detach", "--seconds", "3") == 2


def test_a_start_asks_first(ready, monkeypatch, capsys):
    monkeypatch.setattr("drcli.cli.prompts._line_in_pipe", lambda: "")

    assert ready("start") == 1
    assert "Is its way clear? [y/N]" in capsys.readouterr().err
    assert not [line for line in ready.car.requests if line.startswith("PUT")]


@pytest.mark.parametrize(
    ("state", "sentence"), [("none", "no model"), ("loading", "still loading")]
)
def test_without_a_model_nothing_starts(ready, state, sentence, capsys):
    ready.car.state, ready.car.polls_left = state, 100

    assert ready("start", "-f") == 3
    assert sentence in capsys.readouterr().err


def test_a_stop_is_one_request(ready):
    ready.car.driving = True

    assert ready("stop") == 0
    assert ready.car.requests == ["PUT /api/start_stop"]
    assert not ready.car.driving


def test_a_stop_is_repeated_until_it_is_confirmed(ready):
    ready.car.driving = True
    ready.car.failures["/api/start_stop"] = [502, 504]

    assert ready("stop") == 0
    assert not ready.car.driving


def test_a_stop_that_is_never_confirmed_says_what_to_do(ready, capsys):
    ready.car.refusals["/api/start_stop"] = "Error"

    assert ready("stop") == 4
    said = capsys.readouterr().err
    assert "The car may still drive!" in said
    assert "switch it off" in said


def test_a_stop_with_a_forgotten_login_says_that_the_car_may_drive(ready, capsys):
    ready.car.tokens.clear()

    assert ready("stop") == 3
    said = capsys.readouterr().err
    assert "The car may still drive!" in said
    place = f"--car {ready.address}"
    assert f"`dr-car login {place}` and `dr-car stop {place}`" in said


@pytest.mark.parametrize("percent", ["-1", "101", "ten"])
def test_a_speed_out_of_range_is_not_sent(ready, percent):
    assert ready("speed", "--", percent) == 2 if percent != "-1" else True
    assert ready.car.requests == []


@pytest.mark.parametrize("percent", ["0", "100"])
def test_the_ends_of_the_range_are_speeds(ready, percent):
    assert ready("speed", percent) == 0
    assert ready.car.throttle == int(percent)


# Status.


@pytest.mark.parametrize(("community", "software"), [(True, "community"), (False, "original")])
def test_the_status_tells_which_software_the_car_has(ready, community, software, capsys):
    ready.car.community = community

    assert ready("status", "--json") == 0

    report = printed(capsys)
    assert (report["software"], report["battery_level"]) == (software, 9)
    assert report["sensors"]["lidar"] == "not_connected"
    assert report["model_state"] == "loaded"
    assert bool(report["metrics"]) == community
    assert ready("status") == 0
    assert f"software  {software} 2" in capsys.readouterr().out


def test_what_a_car_cannot_tell_is_unknown(ready, capsys):
    for path in ("get_battery_level", "get_sensor_status", "get_device_info"):
        ready.car.refusals[f"/api/{path}"] = "Error"

    assert ready("status") == 0
    assert "battery   unknown" in capsys.readouterr().out


def test_another_login_at_a_car_with_the_original_software_ends_this_one(
    ready, monkeypatch, tmp_path, capsys
):
    ready.car.community = False
    kept = load_login(CarAddress("127.0.0.1", ready.port))
    monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)
    assert ready("login") == 0
    car_web.save_login(CarAddress("127.0.0.1", ready.port), kept)

    assert ready("list") == 3
    assert "when somebody else logs in" in capsys.readouterr().err.replace("\n", " ")


def test_a_damaged_login_counts_as_none(ready, capsys):
    Path(login_file(CarAddress("127.0.0.1", ready.port))).write_text("{")

    assert ready("list") == 3
    assert "There is no login" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_a_sentence(garage, monkeypatch, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)

    assert garage("login") == 3
    assert "cannot be kept" in capsys.readouterr().err

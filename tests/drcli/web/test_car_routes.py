"""The physical car on the page, against a car that keeps the rules of a real one."""

import io
from pathlib import Path
from urllib.request import urlopen

import pytest
from PIL import Image
from starlette.testclient import TestClient

from drcli.base.clock import wait_until
from drcli.outside.car import car_models
from drcli.web import car_routes
from drcli.web.console_app import build_app
from fake_car import PASSWORD, FakeCar, Installed, archive, make_certificate
from fake_car import served as served_car
from stored_models import StoredModels

BASE = "http://127.0.0.1:8100"


def jpeg(shade: int) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (160, 120), (shade, shade, shade)).save(file, "JPEG")
    return file.getvalue()


@pytest.fixture(scope="module")
def serving(tmp_path_factory):
    car = FakeCar()
    with served_car(car, make_certificate(tmp_path_factory.mktemp("certificate"))) as port:
        yield car, port


@pytest.fixture
def car(serving, folder: Path, monkeypatch):
    """A fresh car that the settings name, and that nobody has logged in at."""
    car, port = serving
    car.__dict__.clear()
    car.__init__()
    car.picture = jpeg(90)
    monkeypatch.setattr(car_models, "POLL_S", 0.005)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    with (folder / "system.env").open("a") as file:
        file.write(f"DR_CAR_ADDRESS=127.0.0.1:{port}\n")
    return car


@pytest.fixture
def logged_in(client, car):
    assert client.post("/api/car/login", json={"password": PASSWORD}).status_code == 200
    return car


def ended(client, answer):
    number, task = answer.json()["task"], {}

    def is_over():
        task.update(client.get(f"/api/tasks/{number}").json())
        return task["ended"] is not None

    assert wait_until(is_over, patience_s=60.0)
    return task


def test_without_an_address_the_page_says_what_is_missing(client):
    answer = client.get("/api/car")

    assert answer.json()["error"]["message"] == "No car is named."
    assert "DR_CAR_ADDRESS" in answer.json()["error"]["remedy"]


def test_a_login_is_asked_for_and_its_password_is_checked(client, car):
    before = client.get("/api/car").json()
    wrong = client.post("/api/car/login", json={"password": "wrong"})
    right = client.post("/api/car/login", json={"password": PASSWORD})

    assert "There is no login at the car" in before["login"]
    assert "does not accept the password" in wrong.json()["error"]["message"]
    assert len(right.json()["fingerprint"]) > 60
    assert client.get("/api/car").json()["login"] == ""


def test_a_model_is_sent_and_loaded(client, logged_in, monkeypatch, tmp_path):
    made = {"file": str(archive(tmp_path / "mine.tar.gz"))}
    # What is exported, and how, is the subject of other tests.
    monkeypatch.setattr(car_routes, "in_subprocess", lambda *_: made)

    sent = ended(client, client.post("/api/car/send", json={"prefix": "model"}))
    loaded = ended(client, client.post("/api/car/load", json={"name": "mine"}))
    shown = client.get("/api/car").json()

    assert sent["result"]["model"] == "mine", sent["error"]
    assert loaded["result"]["model"] == "mine", loaded["error"]
    assert [each["name"] for each in shown["models"]] == ["mine"]
    assert shown["facts"]["model"] == "loaded"


def test_a_model_that_the_car_does_not_have_is_not_loaded(client, logged_in):
    task = ended(client, client.post("/api/car/load", json={"name": "other"}))

    assert "There is no model other on the car" in task["error"]["message"]


def test_the_camera_is_passed_on_as_pictures_and_nothing_else(served, logged_in):
    with urlopen(f"{served.url}/api/car/camera") as answer:
        kind = answer.headers["content-type"]
        start = answer.read(len(logged_in.picture) + 200)

    assert kind == "multipart/x-mixed-replace; boundary=picture"
    assert start.startswith(b"--picture\r\nContent-Type: image/jpeg\r\n")
    assert logged_in.picture in start


def test_the_camera_needs_a_login(client, car):
    answer = client.get("/api/car/camera")

    assert answer.status_code != 200
    assert "There is no login at the car" in answer.json()["error"]["message"]


def test_other_sites_can_neither_send_nor_log_in(folder, car):
    with TestClient(build_app(folder, None), base_url=BASE) as stranger:
        for name in ("login", "send", "load"):
            answer = stranger.post(f"/api/car/{name}", json={}, headers={"origin": "http://evil"})
            assert answer.status_code == 403


def test_the_page_logs_in_and_shows_the_camera_and_the_models(served, visit, car):
    car.models["mine"] = Installed({"sensor": ["FRONT_FACING_CAMERA"]})
    page = visit(f"{served.url}/#/car", width=390).page
    page.get_by_label("Password of the car").fill(PASSWORD)
    page.get_by_role("button", name="Log in").click()

    camera = page.get_by_role("img", name="What the camera of the car sees now")
    camera.wait_for()
    page.get_by_role("button", name="Load mine").click()
    page.get_by_text("The car has loaded mine.").wait_for()

    assert camera.evaluate("image => image.naturalWidth") == 160
    assert page.evaluate("document.documentElement.scrollWidth") == 390


def test_the_page_sends_a_model_of_the_bucket(served, visit, logged_in, monkeypatch, tmp_path):
    StoredModels(served.folder).model("team/mine")
    made = {"file": str(archive(tmp_path / "mine.tar.gz"))}
    monkeypatch.setattr(car_routes, "in_subprocess", lambda *_: made)
    page = visit(f"{served.url}/#/car").page

    page.get_by_label("Model of the bucket").select_option("team/mine")
    page.get_by_role("button", name="Send to").click()

    page.get_by_text("The car has mine now.").wait_for()


def test_the_page_leads_to_the_setting_that_it_needs(served, visit):
    visited = visit(f"{served.url}/#/car")
    visited.page.get_by_role("link", name="Open DR_CAR_ADDRESS").click()

    field = visited.page.get_by_label("DR_CAR_ADDRESS")
    field.wait_for()
    assert field.evaluate("each => each === document.activeElement")
    # Without a car, the browser itself reports what was refused.
    visited.problems[:] = [each for each in visited.problems if "a status of" not in each]

"""Check and start of a training on the page."""

from pathlib import Path

import pytest

from drcli.config.new_folder import plan_folder, write


@pytest.fixture
def folder(empty_folder: Path) -> Path:
    write(plan_folder(empty_folder, {"DR_LOCAL_S3_MODEL_PREFIX": "mine"}))
    return empty_folder


def test_before_the_first_start_the_name_is_free(client):
    found = client.get("/api/start").json()

    assert found["model"] == "mine"
    assert (found["used"], found["checkpoint"], found["trains"]) == (False, None, None)
    assert found["fetch"] == []


def test_a_track_that_is_not_installed_is_told(client, folder):
    text = (folder / "run.env").read_text()
    (folder / "run.env").write_text(text.replace("=reinvent_base", "=Monaco"))

    assert client.get("/api/start").json()["fetch"] == ["Monaco"]


@pytest.mark.parametrize("how", ["wipe", "resume"])
@pytest.mark.parametrize("confirmed", [None, "", "other", True])
def test_deleting_and_continuing_must_be_confirmed(client, how, confirmed):
    answer = client.post("/api/start", json={"how": how, "confirmed": confirmed})

    assert answer.status_code == 409
    assert "must be confirmed" in answer.json()["error"]["message"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"how": "again"},
        {"until_laps": 0},
        {"until_laps": 1.5},
        {"until_laps": "3"},
        {"until_lap_time_s": 0},
        {"until_lap_time_s": "8"},
        {"max_minutes": -1},
        {"max_minutes": True},
        {"seed": 2**32},
    ],
)
def test_a_wrong_start_is_refused(client, wrong):
    assert client.post("/api/start", json=wrong).status_code in (400, 422)


def test_wrong_settings_start_nothing(client, folder):
    with (folder / "run.env").open("a") as file:
        file.write("DR_RACE_TYPE=SLALOM\n")

    answer = client.post("/api/start", json={})

    assert answer.status_code == 422
    assert answer.json()["error"]["problems"][0]["key"] == "DR_RACE_TYPE"


def test_the_check_names_places_that_the_page_can_lead_to(client, folder):
    (folder / "custom_files" / "reward_function.py").write_text("def reward_function(params:\n")
    with (folder / "run.env").open("a") as file:
        file.write("DR_TRAIN_MAX_MINUTES=soon\n")

    found = client.post("/api/validate", json={}).json()

    assert found["ok"] is False
    places = {(each["file"], each["line"]) for each in found["errors"]}
    assert ("custom_files/reward_function.py", 1) in places
    assert "DR_TRAIN_MAX_MINUTES" in [each["key"] for each in found["errors"]]
    assert "V-09" in [rule for each in found["skipped"] for rule in each["rules"]]

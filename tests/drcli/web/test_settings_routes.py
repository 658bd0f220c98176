"""Settings on the page: forms, changes, conflicts and new folders."""

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drcli.bucket.connect import FolderBucket
from drcli.config.loading import load_settings
from drcli.config.new_folder import plan_folder, write
from drcli.model.model_prefix import newest_checkpoint
from drcli.model.model_store import ModelStore


@pytest.fixture
def folder(empty_folder: Path) -> Path:
    return empty_folder


@pytest.fixture
def made(folder: Path) -> Path:
    write(plan_folder(folder, {}))
    return folder


def fields(client: TestClient) -> dict[str, dict[str, Any]]:
    groups = client.get("/api/settings").json()["groups"]
    return {each["name"]: each for group in groups for each in group["settings"]}


def put(client: TestClient, values: dict[str, Any], **more: Any) -> Any:
    versions = client.get("/api/settings").json()["versions"]
    return client.put("/api/settings", json={"values": values, "versions": versions, **more})


def test_an_empty_folder_is_made_as_dr_init_makes_it(client, folder):
    assert client.get("/api/new-folder").json()["exists"] is False

    answer = client.post(
        "/api/new-folder",
        json={"values": {"DR_LOCAL_S3_MODEL_PREFIX": "mine"}, "preset": "virtual"},
    )

    assert answer.status_code == 200, answer.text
    wanted = write(plan_folder(folder / "other", {})).written
    assert sorted(answer.json()["written"]) == sorted(wanted)
    assert "DR_LOCAL_S3_MODEL_PREFIX=mine" in (folder / "run.env").read_text()
    assert "DR_TRAIN_BEST_MODEL_METRIC=laptime" in (folder / "run.env").read_text()
    assert client.get("/api/new-folder").json()["exists"] is True


def test_an_empty_folder_gets_a_trained_model_as_from_dr_init(client, folder):
    *_, (_, models) = client.get("/api/new-folder").json()["begin"]
    offered = [value for value, _ in models]
    wanted = {"values": {"DR_LOCAL_S3_MODEL_PREFIX": "mine"}, "model": "safe"}

    unknown = client.post("/api/new-folder", json={"values": {}, "model": "none"})
    nothing = [path.name for path in folder.iterdir()]
    answer = client.post("/api/new-folder", json=wanted)

    assert "model:safe" in offered
    assert (unknown.status_code, nothing) == (422, [])
    assert "There is no ready-made model called none" in unknown.json()["error"]["message"]
    assert answer.status_code == 200, answer.text
    assert answer.json()["model"] == "s3://bucket/mine"
    bucket = FolderBucket(folder / "data" / "s3" / "bucket")
    assert newest_checkpoint(ModelStore(bucket, "mine")) is not None
    assert load_settings(folder).model_prefix == "mine"


def test_a_wrong_name_makes_no_folder(client, folder):
    body = {"values": {"DR_LOCAL_S3_MODEL_PREFIX": "a b"}}

    answer = client.post("/api/new-folder", json=body)

    assert answer.status_code == 422
    assert "not allowed in a name" in answer.json()["error"]["message"]
    assert not (folder / "run.env").exists()


def test_files_in_the_way_are_replaced_only_when_agreed(client, folder):
    (folder / "system.env").write_text("DR_WORKERS=3\n")

    refused = client.post("/api/new-folder", json={"values": {}})
    agreed = client.post("/api/new-folder", json={"values": {}, "replace": True})

    assert refused.status_code == 409
    assert refused.json()["error"]["clashes"] == ["system.env"]
    assert agreed.status_code == 200
    assert (folder / "system.env.bak").read_text() == "DR_WORKERS=3\n"


def test_a_working_folder_is_not_made_again(client, made):
    before = (made / "run.env").read_bytes()

    answer = client.post("/api/new-folder", json={"values": {}, "replace": True})

    assert answer.status_code == 409
    assert (made / "run.env").read_bytes() == before


def test_the_form_tells_values_their_places_and_limits(client, made):
    found = fields(client)

    metrics = found["DR_LOCAL_S3_METRICS_PREFIX"]
    assert metrics["start"] == "$DR_LOCAL_S3_MODEL_PREFIX/metrics"
    assert metrics["value"] == "rl-deepracer-sagemaker/metrics"
    assert found["DR_WORLD_NAME"]["origin"] == "From run.env."
    assert found["DR_MAX_COST"]["origin"] == "Not set, so the default counts."
    assert found["DR_RACE_TYPE"]["options"][0] == "TIME_TRIAL"
    assert "from 0 to 1000" in found["DR_WORKERS"]["help"]


def test_secrets_are_not_shown(client, made):
    with (made / "system.env").open("a") as file:
        file.write("DR_WEBHOOK_URL=https://hooks.example/T0/very-secret\n")

    answer = client.get("/api/settings").text

    assert "very-secret" not in answer
    assert fields(client)["DR_WEBHOOK_URL"]["secret"] is True


def test_a_change_keeps_comments_and_the_old_file(client, made):
    before = (made / "run.env").read_text()

    answer = put(client, {"DR_WORLD_NAME": "bean", "DR_WORKERS": "2"})

    assert answer.status_code == 200, answer.text
    after = (made / "run.env").read_text()
    assert after == before.replace("DR_WORLD_NAME=reinvent_base", "DR_WORLD_NAME=bean")
    assert (made / "run.env.bak").read_text() == before
    assert "DR_WORKERS=2" in (made / "system.env").read_text()
    assert answer.json()["versions"] == client.get("/api/settings").json()["versions"]


def test_a_wrong_value_is_refused_with_its_key(client, made):
    before = (made / "run.env").read_bytes()

    answer = put(client, {"DR_TRAIN_MAX_MINUTES": "soon"})

    assert answer.status_code == 422
    [problem] = answer.json()["error"]["problems"]
    assert problem["key"] == "DR_TRAIN_MAX_MINUTES"
    assert (made / "run.env").read_bytes() == before
    assert not (made / "run.env.bak").exists()


def test_a_check_writes_nothing(client, made):
    before = (made / "run.env").read_bytes()

    wrong = client.post("/api/settings/check", json={"values": {"DR_WORKERS": "9999"}}).json()
    right = client.post("/api/settings/check", json={"values": {"DR_WORLD_NAME": "bean"}}).json()

    assert wrong["problems"][0]["key"] == "DR_WORKERS"
    assert right["problems"] == []
    assert (made / "run.env").read_bytes() == before


def test_a_file_that_changed_on_the_disk_is_not_overwritten(client, made):
    versions = client.get("/api/settings").json()["versions"]
    text = (made / "run.env").read_text().replace("reinvent_base", "paddle")
    (made / "run.env").write_text(text)
    values = {"DR_WORLD_NAME": "bean"}

    answer = client.put("/api/settings", json={"values": values, "versions": versions})

    assert answer.status_code == 409
    body = answer.json()
    assert body["conflict"] == [{"name": "DR_WORLD_NAME", "yours": "bean", "disk": "paddle"}]
    assert (made / "run.env").read_text() == text
    again = client.put("/api/settings", json={"values": values, "versions": body["versions"]})
    assert again.status_code == 200
    assert "DR_WORLD_NAME=bean" in (made / "run.env").read_text()


def test_a_broken_file_can_still_be_read_and_mended(client, made):
    text = (made / "run.env").read_text()
    (made / "run.env").write_text(text.replace("DR_RACE_TYPE=TIME_TRIAL", "DR_RACE_TYPE=SLALOM"))

    form = client.get("/api/settings").json()
    answer = put(client, {"DR_RACE_TYPE": "TIME_TRIAL"})

    assert form["problems"][0]["key"] == "DR_RACE_TYPE"
    assert answer.status_code == 200, answer.text
    assert (made / "run.env").read_text() == text


@pytest.mark.parametrize(
    "body",
    [
        {"values": {"PATH": "/tmp"}},
        {"values": {"DR_WORKERS": 2}},
        {"values": ["DR_WORKERS"]},
        {"values": {"DR_WORKERS": "2"}, "file": "../other.env"},
        {"values": {"DR_WORKERS": "2\0"}},
        {"values": {"DR_CAR_NAME": "a\nDR_WORKERS=9"}, "versions": {}},
    ],
)
def test_what_is_no_setting_is_refused(client, made, body):
    before = {path.name: path.read_bytes() for path in made.glob("*.env")}

    answer = client.put("/api/settings", json=body)

    assert answer.status_code in (400, 422)
    assert {path.name: path.read_bytes() for path in made.glob("*.env")} == before


def test_a_line_that_is_no_setting_is_written_again(client, made):
    run_env = made / "run.env"
    right = run_env.read_text()
    run_env.write_text(right + "DR_WORKERS several\n")
    form = client.get("/api/settings").json()
    wrong = next(each for each in form["problems"] if each["line"] and not each["key"])
    body = {"file": "run.env", "line": wrong["line"], "version": form["versions"]["run.env"]}

    again = client.put("/api/settings/line", json={**body, "text": "still wrong"})
    other = client.put("/api/settings/line", json={**body, "text": "#", "version": "0"})
    lost = client.put("/api/settings/line", json={**body, "line": 10_000, "text": "#"})
    two = client.put("/api/settings/line", json={**body, "text": "# a\nDR_WORKERS=2"})
    foreign = client.put("/api/settings/line", json={**body, "file": "../x", "text": "#"})

    answers = (again, other, lost, two, foreign)
    assert [each.status_code for each in answers] == [422, 409, 422, 422, 400]
    assert "is not a NAME=value line" in again.json()["error"]["message"]
    assert run_env.read_text() == right + "DR_WORKERS several\n"
    done = client.put("/api/settings/line", json={**body, "text": "DR_WORKERS=2"})
    assert done.status_code == 200, done.text
    assert run_env.read_text() == right + "DR_WORKERS=2\n"
    assert (made / "run.env.bak").read_text().endswith("DR_WORKERS several\n")


def test_tracks_have_an_outline(client, made):
    found = client.get("/api/track-list").json()

    bean = next(each for each in found["tracks"] if each["name"] == "bean")
    assert bean["length_m"] > 1
    inner, outer = bean["outline"]["edges"]
    assert 10 < inner.count("L") <= 100
    assert bean["outline"]["road"] == f"{inner} {outer}"
    assert "Monaco" in found["community"]

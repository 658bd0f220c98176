"""Actions of the console on models: what they refuse, and that they do what commands do."""

import io
import tarfile

import pytest

from drcli.base.clock import wait_until
from drcli.records.run_record import log_file
from drcli.web import model_action_routes
from drcli.web.model_action_routes import TASKS, Clone
from old_model import extract_old_model
from stored_models import StoredModels

PREFIX = "team/model-1"


@pytest.fixture
def models(working_folder):
    stored = StoredModels(working_folder)
    stored.model(PREFIX)
    return stored


def act(client, name, **body):
    return client.post(f"/api/model/{name}", json={"prefix": PREFIX, **body})


def ended(client, answer):
    """The task of an answer, when it has ended."""
    number = answer.json()["task"]
    task = {}

    def is_over():
        task.update(client.get(f"/api/tasks/{number}").json())
        return task["ended"] is not None

    assert wait_until(is_over, patience_s=60.0)
    return task


@pytest.mark.usefixtures("models")
def test_wrong_requests_are_refused_with_a_sentence(client):
    wrong = [
        ("start", {"max_minutes": -1}),
        ("start", {"max_minutes": "soon"}),
        ("start", {"prefix": "nothing/here"}),
        ("evaluate", {"prefix": "../.."}),
        ("evaluate", {"world": ["oval"]}),
        ("clone", {"to": "../up"}),
        ("clone", {"to": "new", "checkpoint": "worst"}),
        ("clone", {"to": "new", "take": ["../run.env"]}),
        ("clone", {"to": "new", "take": "reward_function.py"}),
        ("upload", {"to": ""}),
        ("film", {"stamp": "1", "size": "9999x9999"}),
        ("film", {"stamp": "1", "episode": "../1"}),
        ("film", {"stamp": "1", "ghosts": 500}),
        ("download", {"kind": "passwords"}),
        ("download", {"kind": "car", "checkpoint": "/etc/passwd"}),
        ("delete", {}),
        ("delete", {"confirm": "team"}),
        ("delete", {"prefix": "*", "confirm": "*"}),
    ]
    for name, body in wrong:
        answer = act(client, name, **body)

        assert answer.status_code in (400, 404), (name, body, answer.text)
        assert answer.json()["error"]["message"].endswith("."), (name, body)


@pytest.mark.usefixtures("models")
def test_actions_need_the_origin_of_the_page(client):
    answer = client.post(
        "/api/model/delete",
        json={"prefix": PREFIX, "confirm": PREFIX},
        headers={"origin": "http://evil.example"},
    )

    assert answer.status_code == 403


@pytest.mark.usefixtures("models")
def test_stopping_a_training_that_does_not_run_says_so(client):
    task = ended(client, act(client, "stop"))

    assert task["state"] == "failed"
    assert f"{PREFIX} is not being trained from this folder" in task["error"]["message"]


@pytest.mark.usefixtures("models")
def test_stopping_evaluations_stops_nothing_where_none_runs(client):
    assert ended(client, act(client, "stop-evaluation"))["result"]["stopped"] == []


@pytest.mark.usefixtures("models")
def test_the_logs_of_a_model_are_packed_in_another_process_and_given_out(client, working_folder):
    log = log_file(working_folder, PREFIX, "trainer")
    log.parent.mkdir(parents=True)
    log.write_text("learned\n")
    (log.parent / "link.log").symlink_to(working_folder / "system.env")

    task = ended(client, act(client, "download", kind="logs"))

    answer = client.get(task["result"]["url"])
    assert "model-1-logs.tar.gz" in answer.headers["content-disposition"]
    with tarfile.open(fileobj=io.BytesIO(answer.content)) as archive:
        assert archive.getnames() == ["logs/sagemaker/trainer.log"]


@pytest.mark.usefixtures("models")
def test_a_download_that_fails_shows_the_sentence_of_the_command(client):
    task = ended(client, act(client, "download", kind="logs"))

    assert task["state"] == "failed"
    assert task["error"]["message"] == f"s3://bucket/{PREFIX} has no logs."
    assert task["error"]["code"] == 3


def test_downloads_that_nobody_has_made_do_not_exist(client):
    for name in ("x", "..", "%2e%2e%2fsystem.env"):
        assert client.get(f"/api/download/{name}").status_code == 404


@pytest.mark.usefixtures("models")
def test_what_an_evaluation_can_be_comes_from_settings_and_tracks(client, working_folder):
    with (working_folder / "run.env").open("a") as file:
        file.write("DR_EVAL_NUMBER_OF_TRIALS=4\nDR_LOCAL_S3_PRETRAINED=True\n")
        file.write(f"DR_LOCAL_S3_PRETRAINED_PREFIX={PREFIX}\n")

    found = asked(client, "evaluate")

    assert found["laps"]["value"] == "4"
    assert "reinvent_base" in dict(found["world"]["options"])
    assert "HEAD_TO_MODEL" in dict(found["race_type"]["options"])
    assert found["opponent"]["only"] == ["race_type", ["HEAD_TO_MODEL"]]


def asked(client, about, **query):
    """The fields of a question by their names."""
    query = {"prefix": PREFIX, "about": about, **query}
    answer = client.get("/api/model/question", params=query)
    assert answer.status_code == 200, answer.text
    return {each["name"]: each for each in answer.json()["fields"]}


@pytest.mark.usefixtures("models")
def test_every_question_names_what_its_request_takes(client):
    wrong = client.get("/api/model/question", params={"prefix": PREFIX, "about": "sell"})
    for about in ("start", "stop", "evaluate", "clone", "upload", "download", "delete"):
        body = {"clone": Clone}.get(about) or TASKS[about].work.__annotations__["body"]
        assert set(asked(client, about)) <= set(body.model_fields), about

    assert wrong.status_code == 400
    assert "start, stop, evaluate" in wrong.json()["error"]["message"]


def send(client, name, data, upload=""):
    return client.post(f"/api/uploads?name={name}&upload={upload}", content=data)


def test_uploaded_files_stay_in_their_folder(client, working_folder):
    for name in ("../x", "a/b", ".hidden", "", "x" * 200, "a\\b", "%2e%2e"):
        assert send(client, name, b"data").status_code == 400, name
    for upload in ("..", "../../data", "0" * 24, "x"):
        assert send(client, "a.pb", b"data", upload).status_code in (400, 404), upload

    answer = send(client, "a.pb", b"data").json()

    stored = working_folder / "data" / "viewer" / "uploads" / answer["upload"] / "a.pb"
    assert stored.read_bytes() == b"data"
    assert send(client, "a.pb", b"more", answer["upload"]).status_code == 409
    assert stored.read_bytes() == b"data"


def test_a_file_that_is_too_large_leaves_nothing(client, working_folder, monkeypatch):
    monkeypatch.setattr(model_action_routes, "LARGEST_UPLOAD", 100)

    answer = client.post("/api/uploads?name=big.tar.gz", content=(b"x" * 60 for _ in range(3)))

    assert answer.status_code == 413
    folder = working_folder / "data" / "viewer" / "uploads"
    assert [path for path in folder.rglob("*") if path.is_file()] == []


def test_a_disk_without_room_takes_no_upload(client, monkeypatch):
    monkeypatch.setattr(model_action_routes, "LEAST_FREE", 1 << 60)

    answer = send(client, "a.pb", b"data")

    assert answer.status_code == 503
    assert "no room" in answer.json()["error"]["message"]


def test_an_import_of_something_else_fails_with_a_sentence_and_keeps_nothing(
    client, working_folder
):
    number = send(client, "notes.tar.gz", b"no archive").json()["upload"]

    task = ended(
        client, client.post("/api/models/import", json={"upload": number, "prefix": "new"})
    )

    assert task["state"] == "failed"
    assert task["error"]["message"].startswith("notes.tar.gz ")
    assert not (working_folder / "data" / "viewer" / "uploads" / number).exists()


def test_a_clone_takes_the_files_that_are_wanted_and_shows_what_would_change(
    client, working_folder
):
    extract_old_model(working_folder / "data" / "s3" / "bucket")
    own = working_folder / "custom_files"
    own.mkdir(exist_ok=True)
    (own / "reward_function.py").write_text("def reward_function(params):\n    return 2.0\n")
    (own / "hyperparameters.json").write_text('{"lr": 0.5}')

    query = {"prefix": "model", "about": "clone"}
    plan = client.get("/api/model/question", params=query).json()
    wanted = {"to": "next", "take": ["reward_function.py"], "world": "willow"}
    made = act(client, "clone", **wanted, prefix="model")

    changed = {each["summary"].split()[0]: each["lines"] for each in plan["diffs"]}
    assert "-    return 2.0" in changed["reward_function.py"]
    assert changed["hyperparameters.json"]
    (taken,) = (each for each in plan["fields"] if each["name"] == "take")
    assert taken["value"] == [name for name, _ in taken["options"]] == list(changed)
    assert made.status_code == 200, made.text
    assert "return 2.0" not in (own / "reward_function.py").read_text()
    assert "return 2.0" in (own / "reward_function.py.bak").read_text()
    assert (own / "hyperparameters.json").read_text() == '{"lr": 0.5}'
    assert "DR_WORLD_NAME=willow" in (working_folder / "run.env").read_text()

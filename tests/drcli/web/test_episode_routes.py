"""Answers about episodes: what the page asks is passed on, everything else refused."""

import json

import pytest
from starlette.testclient import TestClient

from drcli.bucket.connect import FolderBucket
from drcli.view.playback.episode_player import EpisodePlayer
from drcli.view.playback.player_handle import unpack
from drcli.view.playback.player_process import answer_of
from drcli.view.video.video_job import Defaults
from drcli.web import episode_routes
from drcli.web.console_app import build_app
from drcli.web.served_folder import ServedFolder
from played_model import EVALUATION, GONE, MODEL, TRAINING, working_folder


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return working_folder(tmp_path_factory.mktemp("racer"))


@pytest.fixture
def client(home, monkeypatch):
    """The console, whose player answers in this process, and whose bucket needs no server."""
    bucket = FolderBucket(home / "data" / "s3" / "bucket")

    class Player(episode_routes.PlayerHandle):
        def _answer(self, line):
            settings = ServedFolder(home, None, None).settings()
            defaults = Defaults.of(settings.model, settings.run.race())
            return answer_of(EpisodePlayer(lambda: (bucket, defaults)), json.loads(line))

    monkeypatch.setattr(episode_routes, "PlayerHandle", Player)
    monkeypatch.setattr(ServedFolder, "bucket", lambda *_: bucket)
    with TestClient(build_app(home, None), base_url="http://127.0.0.1:8100") as made:
        yield made


def test_models_and_traces_are_listed(client):
    models = client.get("/api/play/models").json()
    traces = client.get("/api/play/traces", params={"model": MODEL}).json()

    assert models == {"own": MODEL, "models": [MODEL]}
    assert [each["name"] for each in traces["traces"]] == [GONE, TRAINING, EVALUATION]
    assert traces["traces"][0]["text"].startswith("Iteration ")
    assert traces["traces"][2]["text"].startswith("2026-01-02 03:04:05")


def test_an_episode_is_opened_and_its_pictures_come_packed(client):
    named = {"model": MODEL, "trace": EVALUATION}
    opened = client.get("/api/play/open", params=named).json()
    lap = client.get("/api/play/lap", params={**named, "episode": 1}).json()
    asked = {**named, "episode": "1", "first": "3", "count": "2"}
    steps = client.get("/api/play/steps", params=asked)

    assert len(opened["episodes"]) == 3
    assert opened["title"] == "Evaluation of 2026-01-02 03:04:05"
    assert len(lap["x"]) == 40
    facts, pictures = unpack(steps.content)
    assert steps.headers["content-type"] == episode_routes.PACKED
    assert (facts["first"], len(pictures)) == (3, 2)


@pytest.mark.parametrize(
    ("path", "query", "status", "word"),
    [
        ("open", {}, 400, "needs a model"),
        ("open", {"model": MODEL}, 400, "needs a trace"),
        ("open", {"model": MODEL, "trace": "../../system.env"}, 422, "no trace of a model"),
        ("open", {"model": "../..", "trace": EVALUATION}, 422, "no name of a model"),
        ("open", {"model": MODEL, "trace": "x" * 2000}, 400, "needs a trace"),
        ("open", {"model": "nobody", "trace": EVALUATION}, 503, "nobody"),
        ("traces", {"model": "/etc"}, 422, "no name of a model"),
        ("traces", {"model": "nobody"}, 422, "There is no model"),
        ("lap", {"model": MODEL, "trace": EVALUATION}, 400, "number episode"),
        ("lap", {"model": MODEL, "trace": EVALUATION, "episode": "-1"}, 400, "number episode"),
        ("lap", {"model": MODEL, "trace": EVALUATION, "episode": "٣"}, 400, "number episode"),
        ("lap", {"model": MODEL, "trace": EVALUATION, "episode": "9" * 11}, 400, "too large"),
        ("lap", {"model": MODEL, "trace": EVALUATION, "episode": "7"}, 422, "3 episodes"),
    ],
)
def test_bad_questions_get_a_sentence(client, path, query, status, word):
    answer = client.get(f"/api/play/{path}", params=query)

    assert answer.status_code == status
    assert word in answer.json()["error"]["message"]


def test_the_player_ends_with_the_console(home, monkeypatch):
    closed = []
    monkeypatch.setattr(episode_routes.PlayerHandle, "close", lambda self: closed.append(self))

    with TestClient(build_app(home, None), base_url="http://127.0.0.1:8100"):
        assert not closed

    assert len(closed) == 1

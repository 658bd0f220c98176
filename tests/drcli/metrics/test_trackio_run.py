"""A run at a trackio server: a small one that plays it, and the real one where it is installed."""

import importlib.util
import json
import os
import subprocess
import sys
import threading
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from drcli.config.loading import load_settings
from drcli.metrics.figure_events import Point, TrainingFacts
from drcli.metrics.servers import ServerError, TrackioRun

LEARNED = Point(1000, 20.5, {"losses/entropy": 1.25, "charts/episodic_return": 7.0})
SCORED = Point(900, 21.0, {"evaluation/progress": 88.0}, is_evaluation=True)
NEW, CONTINUED = TrainingFacts("team/model-1", 3), TrainingFacts("team/model-1", 3, 500)


class Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self):
        self.asked, self.tokens, self.earlier = [], [], []
        self.broken = ""
        super().__init__(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_address[1]}"

    def logged(self):
        return [log for what, fields in self.asked if what == "bulk_log" for log in fields["logs"]]


class Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        fields = json.loads(self.rfile.read(int(self.headers["Content-Length"])))["kwargs"]
        self.server.tokens.append(self.headers.get("X-Trackio-Write-Token"))
        code, answer = 200, {"data": None}
        if self.server.broken:
            code, answer = 400, {"error": self.server.broken}
        else:
            self.server.asked.append((self.path.removeprefix("/api/"), fields))
        if self.path.endswith("get_runs_for_project"):
            answer = {"data": self.server.earlier}
        data = json.dumps(answer).encode()
        self.send_response(code)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    made = Server()
    yield made
    made.shutdown()
    made.server_close()


def test_the_server_gets_numbers_steps_and_parameters(server, monkeypatch):
    monkeypatch.setenv("TRACKIO_WRITE_TOKEN", "abc")
    sink = TrackioRun(server.url + "/", "cars", NEW, {"lr": "0.001"})

    sink.send(LEARNED)
    sink.send(SCORED)
    sink.close()

    first, second = server.logged()
    assert (first["project"], first["run"]) == ("cars", "team/model-1")
    assert (first["metrics"], first["step"]) == (LEARNED.values, 1000)
    assert first["config"] == {"lr": "0.001"}
    assert first["run_id"] == second["run_id"]
    assert first["log_id"] != second["log_id"]
    assert set(server.tokens) == {"abc"}


def test_a_continued_training_continues_the_newest_run_of_its_model(server):
    server.earlier = [
        {"id": "old", "name": "team/model-1", "created_at": "2026-01-01"},
        {"id": "newer", "name": "team/model-1", "created_at": "2026-02-01"},
        {"id": "other", "name": "team/model-2", "created_at": "2026-03-01"},
    ]
    sink = TrackioRun(server.url, "cars", CONTINUED, {})

    sink.send(LEARNED)
    sink.close()

    assert server.logged()[0]["run_id"] == "newer"


def test_numbers_wait_while_the_server_refuses_them(server):
    server.broken = "A write_token is required."
    sink = TrackioRun(server.url, "cars", NEW, {})
    with pytest.raises(ServerError, match=r"answered with 400: A write_token is required\.$"):
        sink.send(LEARNED)
    assert sink.miss(LEARNED)  # it is kept already
    assert sink.miss(SCORED)
    server.broken = ""

    sink.close()

    assert [log["step"] for log in server.logged()] == [1000, 900]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("DR_TRACKIO_URL=http://host:7860/?write_token=secret", "contains a token or password"),
        ("DR_TRACKIO_URL=host:7860", "is not a web address"),
        ("DR_TRACKIO_PROJECT=a b", "is not the name of a trackio project"),
        ("DR_TRACKIO_PROJECT=registry-a", "is not the name of a trackio project"),
    ],
)
def test_settings_that_the_server_would_not_take_are_refused(tmp_path, line, words):
    (tmp_path / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=m\n")
    (tmp_path / "system.env").write_text(line + "\n")

    with pytest.raises(Exception, match=line.partition("=")[0]) as error:
        load_settings(tmp_path)

    assert words in str(error.value)
    assert "secret" not in str(error.value)


@pytest.mark.skipif(importlib.util.find_spec("trackio") is None, reason="trackio is not installed")
def test_the_real_server_keeps_the_run(tmp_path, monkeypatch):
    monkeypatch.setenv("TRACKIO_WRITE_TOKEN", "abc")
    source = (
        "import sys, trackio\n"
        "shown = trackio.show(open_browser=False, block_thread=False)\n"
        "print('URL', shown[1], flush=True)\n"
        "sys.stdin.read()\n"
    )
    own = {"TRACKIO_DIR": str(tmp_path), "HF_HUB_OFFLINE": "1", "HOME": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-c", source],
        env={**os.environ, **own},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            url = next(line.split()[1] for line in process.stdout if line.startswith("URL "))
            url = url.partition("?")[0].rstrip("/")
            TrackioRun(url, "cars", NEW, {"lr": "0.001"}).send(LEARNED)
            TrackioRun(url, "cars", CONTINUED, {}).send(SCORED)
            runs = asked(url, "get_runs_for_project", project="cars")
            entries = asked(url, "get_logs", project="cars", run="team/model-1")
        finally:
            process.kill()

    assert [run["name"] for run in runs] == ["team/model-1"]
    assert sorted(entry["step"] for entry in entries) == [900, 1000]
    assert any(entry.get("losses/entropy") == 1.25 for entry in entries)


def asked(url, what, **fields):
    request = urllib.request.Request(
        f"{url}/api/{what}",
        json.dumps({"args": [], "kwargs": fields}).encode(),
        {"Content-Type": "application/json"},
    )
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.load(answer)["data"]

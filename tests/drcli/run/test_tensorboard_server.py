"""TensorBoard of a working folder, played by a small server of the same name."""

import json
import urllib.request

import psutil
import pytest

from drcli.base.errors import NotAvailable, SettingsError
from drcli.base.processes import exists
from drcli.config.loading import load_settings
from drcli.model import keys
from drcli.model.history import decode_history
from drcli.records.iteration import encode_history
from drcli.run import stopping
from drcli.run import tensorboard_server as metrics
from memory_bucket import MemoryBucket

SERVER = """
import http.server, sys
port = int(sys.argv[sys.argv.index("--port") + 1])
http.server.HTTPServer(("127.0.0.1", port), http.server.SimpleHTTPRequestHandler).serve_forever()
"""

RECORD = {
    **{"iteration": 0, "checkpoint": "0_Step-0.ckpt", "episodes": 2, "steps": 9, "total_steps": 9},
    **{"mean_reward": 1.5, "mean_progress": 2.0, "full_laps": 0, "best_lap_s": None},
    **{"elapsed_s": 3.0, "evaluation_progress": [4.0]},
}


@pytest.fixture
def settings(tmp_path):
    """The settings of a folder with these lines in system.env."""

    def make(*lines):
        (tmp_path / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=m\n")
        (tmp_path / "system.env").write_text("\n".join(lines) + "\n")
        return load_settings(tmp_path)

    return make


@pytest.fixture
def played(tmp_path, monkeypatch):
    """Lets a program of ours be TensorBoard."""

    def play(source):
        folder = tmp_path / "path" / "tensorboard"
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text("")
        (folder / "main.py").write_text(source)
        monkeypatch.setenv("PYTHONPATH", str(folder.parent))
        monkeypatch.setattr(metrics, "is_installed", lambda: True)

    return play


def test_it_answers_until_it_is_stopped_and_is_started_once(settings, played, tmp_path):
    played(SERVER)
    loaded = settings("DR_TELEGRAF_HOST=grafana")
    try:
        report = metrics.start_tensorboard(loaded)
        with urllib.request.urlopen(report.url, timeout=30) as answer:
            assert answer.status == 200
        again = metrics.start_tensorboard(loaded)
    finally:
        record = metrics.stop_tensorboard(tmp_path)

    assert again.pid == report.pid == record.pid
    assert not exists(record.pid)
    assert {tool.name: tool.place for tool in report.tools}["Grafana"] == "udp://grafana:8092"
    assert metrics.stop_tensorboard(tmp_path) is None


def test_it_reads_files_in_the_way_that_drops_what_was_given_up(settings, played):
    played(SERVER)
    loaded = settings()
    try:
        report = metrics.start_tensorboard(loaded)
        words = psutil.Process(report.pid).cmdline()
    finally:
        metrics.stop_tensorboard(loaded.directory)

    assert words[words.index("--load_fast") + 1] == "false"


def test_it_is_stopped_with_everything_else(settings, played, tmp_path):
    played(SERVER)
    loaded = settings()
    report = metrics.start_tensorboard(loaded)
    try:
        stopping.stop_all(tmp_path, lambda: loaded.storage)
    finally:
        left = metrics.stop_tensorboard(tmp_path)

    assert left is None
    assert not exists(report.pid)


def test_one_that_does_not_start_leaves_nothing(settings, played, tmp_path):
    played("raise SystemExit('no more disk space')")

    with pytest.raises(SettingsError, match="no more disk space"):
        metrics.start_tensorboard(settings())

    assert metrics.running_tensorboard(tmp_path) is None


def test_without_the_package_other_tools_are_listed(settings, monkeypatch):
    monkeypatch.setattr(metrics, "is_installed", lambda: False)

    with pytest.raises(NotAvailable, match="TensorBoard is not installed") as error:
        metrics.check_tensorboard(settings("DR_TENSORBOARD=True"))
    assert "DR_TELEGRAF_HOST" in error.value.remedy

    loaded = settings("DR_PROMETHEUS_PORT=9464")
    metrics.check_tensorboard(loaded)
    assert metrics.write_histories(loaded, MemoryBucket(), ["m"]) == []
    assert metrics.start_tensorboard(loaded).url is None


def test_models_without_event_files_get_them_from_their_history(settings, tmp_path):
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    bucket = MemoryBucket()
    history = json.dumps({"iterations": [RECORD]}).encode()
    bucket.put(keys.history("m"), encode_history(decode_history(history)))

    made = metrics.write_histories(settings(), bucket, ["m", "nothing"])

    assert made == ["m"]
    assert len(list((tmp_path / "data" / "tensorboard" / "m").iterdir())) == 1
    assert metrics.write_histories(settings(), bucket, ["m"]) == []

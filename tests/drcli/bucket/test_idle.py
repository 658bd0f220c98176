"""A server that nobody uses ends, and one that anybody uses does not. The clock is moved."""

import errno
import http.client
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import replace

import psutil
import pytest

from drcli.base.clock import wait_until
from drcli.base.errors import StorageError
from drcli.base.files import exclusive
from drcli.bucket.connect import open_bucket
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server, server_process
from drcli.bucket.server import server as idle
from drcli.bucket.server.server import IdleWatcher
from drcli.bucket.server.server_process import LOG_BYTES
from drcli.config.run_config import StorageConfig

MINUTE_S = 60.0

USER = """
import sys
from pathlib import Path
from drcli.bucket.server import server
from drcli.config.run_config import StorageConfig
print(server.ensure_running(StorageConfig("local", "bucket", Path(sys.argv[1]))).pid, flush=True)
sys.stdin.read()
"""


class Served:
    """A server that was started, and a watch on it whose time a test moves."""

    def __init__(self, config):
        self.config = config
        self.endpoint = server.ensure_running(config)
        self.now_s = 0.0
        port = int(str(self.endpoint.url).rpartition(":")[2])
        self.port = port
        self.watch = IdleWatcher(config.data_dir, port, self.endpoint.pid, clock=lambda: self.now_s)

    @property
    def runs(self):
        return server_process.is_running(self.endpoint.pid, f"127.0.0.1:{self.port}")

    def pass_minutes(self, count):
        """Look every half minute; whether the watch is over."""
        for _ in range(2 * count):
            self.now_s += MINUTE_S / 2
            if self.watch.look():
                return True
        return False


@pytest.fixture
def served(local):
    """Started by a command that has ended since."""
    made = Served(local)
    idle.not_in_use(local.data_dir)
    return made


def state_of(config):
    return json.loads((config.data_dir / ".server.json").read_text())


def test_a_server_that_nobody_uses_ends_after_ten_minutes(served):
    early = served.pass_minutes(9)

    assert not early
    assert served.runs
    assert served.pass_minutes(2)
    assert not served.runs


def test_the_next_command_brings_it_back_on_its_port_with_its_objects(served):
    with closing(S3Bucket(served.endpoint, "bucket")) as bucket:
        bucket.put("k", b"kept")
        served.pass_minutes(11)

        again = server.ensure_running(served.config)

        assert (again.url, again.secret_key) == (served.endpoint.url, served.endpoint.secret_key)
        assert bucket.get("k") == b"kept"


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_a_single_request_of_another_program_counts_though_it_is_refused(served, method):
    served.pass_minutes(9)

    with closing(http.client.HTTPConnection("127.0.0.1", served.port, timeout=10)) as stranger:
        stranger.request(method, "/bucket/k")
        stranger.getresponse().read()

    assert not served.pass_minutes(9)
    assert served.runs
    assert served.pass_minutes(2)


def test_a_download_that_goes_on_counts_at_every_look(served):
    with closing(S3Bucket(served.endpoint, "bucket")) as bucket:
        # Twice what is read, because the server writes up to about 10 MB ahead into socket buffers.
        bucket.put("large", b"x" * (64 << 20))
        client = bucket._client
        body = client.get_object(Bucket="bucket", Key="large")["Body"]
        for _ in range(8):
            body.read(4 << 20)
            assert not served.pass_minutes(3)
        body.close()

    assert served.runs


def test_a_process_of_ours_that_only_computes_keeps_it(local):
    user = subprocess.Popen(
        [sys.executable, "-c", USER, str(local.data_dir)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with user:
        assert int(user.stdout.readline()) > 0
        served = Served(local)
        idle.not_in_use(local.data_dir)

        assert not served.pass_minutes(60)

        user.kill()  # no farewell: its hold goes with it

    assert served.pass_minutes(1)
    assert not served.runs


def test_a_command_that_is_looking_for_it_keeps_it(served):
    with exclusive(served.config.data_dir / ".server.lock", patience_s=10):
        assert not served.pass_minutes(11)
        assert served.runs

    assert served.pass_minutes(1)


def test_zero_minutes_keep_it_for_ever(local):
    served = Served(replace(local, idle_minutes=0))
    idle.not_in_use(local.data_dir)

    assert state_of(local)["watcher"] is None
    assert served.pass_minutes(1)  # nothing to watch
    assert served.runs


def test_the_setting_of_the_last_command_counts(served):
    server.ensure_running(replace(served.config, idle_minutes=30))
    idle.not_in_use(served.config.data_dir)

    assert not served.pass_minutes(29)
    assert served.pass_minutes(2)


def test_where_the_system_does_not_tell_what_it_reads_it_is_left_alone(local, monkeypatch):
    monkeypatch.setattr(idle, "traffic_bytes", lambda pid: None)
    served = Served(local)
    idle.not_in_use(local.data_dir)

    assert served.pass_minutes(1)
    assert served.runs


def test_it_ends_with_the_folder_that_it_serves(served):
    shutil.rmtree(served.config.data_dir)

    assert served.pass_minutes(11)
    assert not served.runs


def test_a_damaged_state_does_not_keep_it(served):
    (served.config.data_dir / ".server.json").write_text("{")

    assert served.pass_minutes(11)
    assert not served.runs


def test_the_log_of_a_server_that_runs_for_months_stays_small(served):
    log = served.config.data_dir / ".server.log"
    log.write_text("x" * (LOG_BYTES + 1))

    served.pass_minutes(1)

    assert log.stat().st_size == 0


def test_a_watch_is_over_once_its_server_has_ended(served):
    server.stop(served.config)

    assert served.watch.look()


def test_a_watcher_of_little_size_comes_and_goes_with_the_server(local):
    user = subprocess.Popen(
        [sys.executable, "-c", USER, str(local.data_dir)], stdout=subprocess.PIPE, text=True
    )
    with user:
        user.stdout.readline()
        user.kill()  # whoever started them both
    first = psutil.Process(state_of(local)["watcher"])
    assert wait_until(
        lambda: "drcli.bucket.server.server" in " ".join(first.cmdline()), patience_s=10
    )

    os.kill(state_of(local)["pid"], signal.SIGKILL)
    assert wait_until(lambda: not first.is_running(), patience_s=10)
    server.ensure_running(local)
    second = psutil.Process(state_of(local)["watcher"])

    assert second != first
    assert second.memory_info().rss < 30 << 20
    server.stop(local)
    assert wait_until(lambda: not second.is_running(), patience_s=10)


def test_a_server_whose_watcher_is_gone_gets_another_one(local):
    server.ensure_running(local)
    first = state_of(local)["watcher"]
    os.kill(first, signal.SIGKILL)
    assert wait_until(lambda: not psutil.pid_exists(first), patience_s=10)

    endpoint = server.ensure_running(local)

    assert state_of(local)["pid"] == endpoint.pid
    assert psutil.pid_exists(state_of(local)["watcher"])


def test_on_a_full_disk_a_server_without_watcher_works_and_no_watcher_is_started(
    local, monkeypatch
):
    endpoint = server.ensure_running(local)
    os.kill(state_of(local)["watcher"], signal.SIGKILL)

    def refuse(state, path):
        raise OSError(errno.ENOSPC, "No space left on device")

    started = []
    with monkeypatch.context() as full:
        full.setattr(server.ServerState, "write", refuse)
        full.setattr(server_process, "start_detached", lambda *_, **__: started.append(1))

        assert server.ensure_running(local).pid == endpoint.pid

    assert not started


def test_a_server_of_an_earlier_version_gets_a_watcher(local):
    server.ensure_running(local)
    state = state_of(local)
    os.kill(state.pop("watcher"), signal.SIGKILL)
    del state["idle_minutes"]
    (local.data_dir / ".server.json").write_text(json.dumps(state))

    server.ensure_running(local)

    assert psutil.pid_exists(state_of(local)["watcher"])


def test_a_command_that_comes_in_the_moment_of_the_end_finds_a_server(local):
    for _ in range(5):
        served = Served(local)
        idle.not_in_use(local.data_dir)
        served.now_s = 11 * MINUTE_S
        served.watch._used_s = 0.0
        served.watch._was_used()
        ending = threading.Thread(target=served.watch.look)
        ending.start()
        with closing(open_bucket(local, patience_s=0.0)) as bucket:
            ending.join()
            bucket.put("k", b"found")
            assert bucket.get("k") == b"found"


def test_a_folder_without_a_server_needs_no_hold(tmp_path):
    idle.not_in_use(tmp_path)

    with pytest.raises(StorageError, match="DR_REMOTE_MINIO_URL"):
        server.ensure_running(
            StorageConfig("remote", "bucket", tmp_path)  # starts and holds nothing
        )

    assert not list(tmp_path.iterdir())

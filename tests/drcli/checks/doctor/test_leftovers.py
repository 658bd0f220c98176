"""Records, processes and ports that earlier runs left."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from drcli.checks.doctor.leftovers import examine_runs, examine_server
from drcli.config.run_config import StorageConfig
from drcli.records.run_record import RunRecord, run_folder

ENDED_PID = 2**22 + 1
"""Larger than any process number."""


def record(folder: Path, run_id: int, pid: int, state: str = "running") -> None:
    RunRecord(
        run_id=run_id,
        session="s",
        bucket="bucket",
        prefix="model",
        world="w",
        state=state,
        pid=pid,
        pid_started=1.0,
        started_at=1.0,
    ).write(run_folder(folder, run_id))


def test_a_folder_in_which_nothing_ever_ran_is_fine(tmp_path):
    [found] = examine_runs(tmp_path)

    assert found.state == "ok"
    assert not list(tmp_path.iterdir())


def test_a_run_that_died_silently_is_a_warning_and_one_that_ended_is_not(tmp_path):
    record(tmp_path, 0, ENDED_PID)
    record(tmp_path, 1, ENDED_PID, "finished")

    [found] = examine_runs(tmp_path)

    assert found.state == "warning"
    assert "run 0 of s3://bucket/model" in found.text
    assert "--resume" in found.remedy
    assert found.facts["lost"] == [0]


def test_a_damaged_record_is_named(tmp_path):
    record(tmp_path, 3, ENDED_PID)
    (run_folder(tmp_path, 3) / "run.json").write_text('{"run_id": 3')

    [found] = examine_runs(tmp_path)

    assert "run.json is damaged" in found.text


def test_a_worker_whose_supervisor_is_gone_is_found(tmp_path):
    """It looks like a worker: by its command line and folder."""
    sleeps = "import time; print(flush=True); time.sleep(60)"
    # A parent that knows nothing of us, as a session's init would.
    starts = (
        "import subprocess, sys; "
        f"p = subprocess.Popen([sys.executable, '-c', {sleeps!r}, 'drcli.train.sim'], "
        "stdout=subprocess.PIPE); p.stdout.readline(); print(p.pid, flush=True); sys.stdin.read(); "
        "p.kill(); p.wait()"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", starts],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        pid = int(parent.stdout.readline())

        [found] = examine_runs(tmp_path)
        [elsewhere] = examine_runs(tmp_path.parent)
    finally:
        parent.communicate(timeout=30)

    assert found.facts["orphans"] == [pid]
    assert f"kill -9 {pid}" in found.remedy
    assert elsewhere.state == "ok"


def storage(tmp_path, port=None):
    return StorageConfig("local", "bucket", tmp_path / "s3", port=port)


def test_a_taken_port_is_a_problem_only_if_it_was_asked_for(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]

        [taken] = examine_server(storage(tmp_path, port))
        [free] = examine_server(storage(tmp_path))

    assert taken.state == "problem"
    assert f"port {port}" in taken.text
    assert f"process {os.getpid()}" in taken.text
    assert free.state == "ok"
    assert not (tmp_path / "s3").exists()


@pytest.mark.parametrize("cloud", ["aws", "remote"])
def test_without_a_server_of_our_own_nothing_is_said(tmp_path, cloud):
    assert list(examine_server(StorageConfig(cloud, "bucket", tmp_path))) == []

"""The notes that runs leave on this machine, whatever state they are in."""

import json
import os
import subprocess
import sys
import time

import psutil
import pytest

from drcli.base.processes import exists, is_alive, started_s
from drcli.config.loading import load_settings
from drcli.config.run_config import StorageConfig
from drcli.records.run_record import (
    EvaluationRecord,
    RunRecord,
    WorkerRecord,
    run_folder,
    running_evaluations,
)
from drcli.run.status import inspect
from drcli.run.stopping import running_trainings, stop_runs

DAMAGED = ["", "{", "[]", "null", "7", "{}", '{"workers": [1]}', '{"workers": []}']


def test_a_record_is_read_as_it_was_written(tmp_path):
    note = RunRecord(
        *(0, "one", "bucket", "model", "oval", "running"),
        pid=os.getpid(),
        pid_started=psutil.Process().create_time(),
        started_at=1.0,
        workers=[WorkerRecord("trainer", 17, 2)],
    )

    note.write(tmp_path)

    assert RunRecord.read(tmp_path) == note


def test_the_bucket_of_a_run_that_version_0_1_0_wrote_is_found(tmp_path):
    storage = {
        "cloud": "local",
        "bucket": "mine",
        "remote_minio_url": "",
        "profile": "",
        "aws_app_region": "us-east-1",
        "local_s3_engine": "rclone",
        "s3_data_dir": "data/s3",
    }
    note = {
        **{"run_id": 0, "session": "one", "bucket": "mine", "prefix": "model", "world": "oval"},
        **{"state": "finished", "pid": 17, "pid_started": 1.0, "started_at": 1.0},
        **{"workers": [], "storage": storage},
    }
    (tmp_path / "run.json").write_text(json.dumps(note))
    now = StorageConfig("aws", "other", tmp_path / "elsewhere", port=4711, profile="me")

    record = RunRecord.read(tmp_path)

    assert record is not None
    found = record.storage_at_start(now, tmp_path)
    assert found == StorageConfig("local", "mine", tmp_path / "data/s3", port=4711)


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_record_of_a_training_is_none(working_folder, content):
    settings = load_settings(working_folder, environ={})
    folder = run_folder(working_folder, settings.run_id)
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(content)

    assert RunRecord.read(folder) is None
    assert inspect(settings.run).state == "none"
    assert running_trainings(working_folder) == []


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_record_of_an_evaluation_is_none(tmp_path, content):
    folder = tmp_path / "data" / "runs" / "0" / "evaluations" / "20260102030405"
    folder.mkdir(parents=True)
    (folder / "running.json").write_text(content)

    assert EvaluationRecord.read(folder) is None
    assert running_evaluations(tmp_path) == []
    assert stop_runs(tmp_path) == []


def test_a_process_stays_alive_when_somebody_sets_the_clock(monkeypatch):
    began_s = started_s(os.getpid())
    monkeypatch.setattr(psutil.Process, "create_time", lambda self: time.time() + 75.0)

    assert is_alive(os.getpid(), began_s)


def test_a_process_that_got_the_number_of_another_is_not_that_one():
    assert not is_alive(os.getpid(), started_s(os.getpid()) - 2.0)


def test_records_of_older_versions_hold_the_time_of_day():
    assert is_alive(os.getpid(), psutil.Process().create_time())
    assert not is_alive(os.getpid(), psutil.Process().create_time() - 1000.0)


def test_a_process_that_has_ended_is_not_alive():
    child = subprocess.Popen([sys.executable, "-S", "-c", "pass"])
    began_s = started_s(child.pid)
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)

    assert not is_alive(child.pid, began_s)
    child.wait()
    assert not is_alive(child.pid, began_s)


@pytest.mark.parametrize("pid", [-1, 2**31, 2**70])
def test_no_number_that_is_none_of_a_process_counts_as_one(pid):
    assert not exists(pid)

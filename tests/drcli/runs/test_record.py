"""The notes that runs leave on this machine, whatever state they are in."""

import os
import socket
import subprocess
import sys
import time

import psutil
import pytest

from drcli.runs.evaluation_record import EvaluationRecord, running_evaluations
from drcli.runs.lease import Lease, is_owner_alive
from drcli.runs.record import RunRecord, WorkerRecord, exists, run_folder
from drcli.runs.status import inspect
from drcli.runs.stopping import running_trainings, stop_runs

DAMAGED = ["", "{", "[]", "null", "7", "{}", '{"workers": [1]}', '{"workers": []}']


def test_a_note_is_read_as_it_was_written(tmp_path):
    note = RunRecord(
        *(0, "one", "bucket", "model", "oval", "running"),
        pid=os.getpid(),
        pid_started=psutil.Process().create_time(),
        started_at=1.0,
        workers=[WorkerRecord("trainer", 17, 2)],
    )

    note.write(tmp_path)

    assert RunRecord.read(tmp_path) == note


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_note_of_a_training_is_none(racer, content):
    folder = run_folder(racer.settings(), racer.folder)
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(content)

    assert RunRecord.read(folder) is None
    assert inspect(racer.settings(), racer.folder).state == "none"
    assert running_trainings(racer.folder) == []


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_note_of_an_evaluation_is_none(tmp_path, content):
    folder = tmp_path / "data" / "runs" / "0" / "evaluations" / "20260102030405"
    folder.mkdir(parents=True)
    (folder / "running.json").write_text(content)

    assert EvaluationRecord.read(folder) is None
    assert running_evaluations(tmp_path) == []
    assert stop_runs(tmp_path) == []


def test_a_process_that_has_ended_and_was_not_taken_note_of_does_not_run():
    process = subprocess.Popen([sys.executable, "-c", ""])
    deadline_s = time.monotonic() + 30.0
    try:
        while psutil.Process(process.pid).status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)

        assert psutil.pid_exists(process.pid)
        assert not exists(process.pid)
        held = Lease("abc", socket.gethostname(), process.pid, time.time())
        assert not is_owner_alive(held)
    finally:
        process.wait()


@pytest.mark.parametrize("pid", [-1, 2**31, 2**70])
def test_no_number_that_is_none_of_a_process_counts_as_one(pid):
    assert not exists(pid)

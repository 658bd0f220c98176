"""What is said about a run, from the note that its supervisor leaves."""

import os
import time

import psutil
import pytest

from drcli.runs import record
from drcli.runs.record import RunRecord, run_folder
from drcli.runs.status import inspect


@pytest.fixture
def running(racer):
    """A run whose supervisor is this process."""
    note = RunRecord(
        run_id=0,
        session="one",
        bucket="bucket",
        prefix="model-1",
        world="reinvent_base",
        state="running",
        pid=os.getpid(),
        pid_started=psutil.Process().create_time(),
        started_at=time.time(),
    )
    note.write(run_folder(racer.settings(), racer.folder))
    return note


def test_a_run_that_ends_while_it_is_looked_at_has_ended_well(racer, running, monkeypatch):
    def ends_in_this_moment(pid: int, pid_started: float) -> bool:
        ended = running.ended("finished", 0, "Training is complete.", "", time.time())
        ended.write(run_folder(racer.settings(), racer.folder))
        return False

    monkeypatch.setattr(record, "is_alive", ends_in_this_moment)

    report = inspect(racer.settings(), racer.folder)

    assert (report.state, report.message) == ("finished", "Training is complete.")


def test_a_run_whose_supervisor_is_gone_without_a_word_is_lost(racer, running, monkeypatch):
    monkeypatch.setattr(record, "is_alive", lambda pid, pid_started: False)

    report = inspect(racer.settings(), racer.folder)

    assert report.state == "lost"
    assert "--resume" in report.remedy


def test_a_run_with_a_living_supervisor_is_running(racer, running):
    assert inspect(racer.settings(), racer.folder).state == "running"

"""Commands as child processes of a supervisor, with the settings of its start."""

import os
import time

import psutil
import pytest

from drcli.config import secret_environment
from drcli.run.command_process import CommandProcess
from unwatched import job_of


@pytest.fixture
def job(tmp_path):
    job = job_of(tmp_path, "DR_UPLOAD_S3_PREFIX=team/up-1", "DR_WORKERS=3")
    job.folder.mkdir(parents=True)
    return job


def shown(end):
    """Values by name that `dr config show --json` printed."""
    return {each["name"]: each["value"] for each in end.report["settings"]}


def test_a_command_reports_and_sees_the_settings_of_the_start(job):
    edited = "DR_LOCAL_S3_MODEL_PREFIX=another\nDR_UPLOAD_S3_PREFIX=other\nDR_WORKERS=1\n"
    (job.directory / "run.env").write_text(edited)
    names = "DR_LOCAL_S3_MODEL_PREFIX", "DR_UPLOAD_S3_PREFIX", "DR_WORKERS"

    end = CommandProcess(job, "config", "show", *names, "--json").wait(60.0)

    assert end.ok, end.reason
    assert [shown(end)[name] for name in names] == ["team/model", "team/up-1", "3"]


def test_a_failure_has_its_error_and_its_remedy(job, logged):
    end = CommandProcess(job, "config", "show", "DR_NO_SUCH_NAME").wait(60.0)

    assert not end.ok
    assert "DR_NO_SUCH_NAME" in end.reason
    assert "Error:" not in end.reason
    assert "DR_NO_SUCH_NAME" not in logged()  # the caller tells it, once


def test_a_command_is_killed_in_time_and_gives_way_to_the_training(job):
    # A web address that accepts nothing keeps it busy; without one it is killed as it loads.
    process = CommandProcess(job, "logs", "trainer", "-f")
    began_s = time.monotonic()

    end = process.wait(0.2)

    assert end.killed
    assert "its time was over" in end.reason
    assert time.monotonic() - began_s < 5.0
    assert not psutil.pid_exists(process.pid)


def test_secrets_are_neither_in_the_environment_nor_in_the_command_line(job, monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "canary-one")
    monkeypatch.setattr(secret_environment, "_kept", {"DR_DROA_PASSWORD": "canary-two"})
    monkeypatch.setattr(secret_environment, "hide_process", lambda: None)
    process = CommandProcess(job, "config", "show", "DR_WORKERS", "--json")

    child = psutil.Process(process.pid)
    try:
        seen = f"{child.environ()} {child.cmdline()}"
    finally:
        process.wait(60.0)

    assert "canary" not in seen
    assert "canary-one" in os.environ["AWS_SECRET_ACCESS_KEY"]

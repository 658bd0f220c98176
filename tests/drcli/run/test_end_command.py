"""The command that runs when a training has ended."""

import shlex
import time

import pytest

from drcli.config import secret_environment
from drcli.run.end_of_training import EndCommand
from drcli.run.outcome import INTERRUPTED
from unwatched import Watched, ending, job_of, running


@pytest.fixture
def leave(tmp_path):
    """Let a training with this command end."""

    def run(command, end, facts=None):
        job = job_of(tmp_path, f"DR_ON_END={shlex.quote(command)}" if command else "")
        training = running(job)
        watch = Watched(training)
        watch.has(9, best=7)
        EndCommand(training, watch, lambda: facts or {}).after_release(end)
        told = tmp_path / "told"
        return dict(line.split("=", 1) for line in told.read_text().splitlines())

    return run


def test_it_learns_how_the_training_ended(leave, logged):
    told = leave("env | grep ^DR_END_ > told; echo hello", ending(6, None, "NaN."), {"cost": 1.5})

    assert told["DR_END_STATE"] == "failed"
    assert told["DR_END_CODE"] == "6"
    assert told["DR_END_MESSAGE"] == "NaN."
    assert told["DR_END_PREFIX"] == "team/model"
    assert told["DR_END_BEST_CHECKPOINT"] == "7_Step-700.ckpt"
    assert told["DR_END_LAST_CHECKPOINT"] == "9_Step-900.ckpt"
    assert told["DR_END_COST"] == "1.5"
    assert told["DR_END_SECONDS_LEFT"] == ""
    assert "on end: hello" in logged()


def test_it_also_runs_after_an_interruption_and_knows_the_time(leave):
    told = leave("env | grep ^DR_END_ > told", ending(INTERRUPTED, 50.0))

    assert told["DR_END_STATE"] == "interrupted"
    assert 40 <= int(told["DR_END_SECONDS_LEFT"]) <= 50


def test_it_has_the_secrets_that_were_kept_from_the_racers_code(leave, monkeypatch):
    monkeypatch.setattr(secret_environment, "_kept", {"MY_SECRET_TOKEN": "abc"})

    assert leave('echo "X=$MY_SECRET_TOKEN" > told', ending())["X"] == "abc"


def test_a_failure_is_told_and_changes_nothing(leave, logged):
    leave("echo A=1 > told; exit 3", ending())

    assert "failed with exit code 3" in logged()


def test_it_is_killed_when_the_time_is_over(leave, logged):
    began_s = time.monotonic()
    leave("echo A=1 > told; sleep 60", ending(INTERRUPTED, 0.5))

    assert time.monotonic() - began_s < 10.0
    assert "its time was over" in logged()


def test_its_text_is_not_logged_because_it_may_hold_secrets(leave, logged):
    leave("TOKEN=geheim; echo A=1 > told", ending())

    assert "geheim" not in logged()

"""Trainings whose machines come and go: one command starts, resumes, or does nothing."""

import json
import os
import shutil
import signal
import time
from dataclasses import replace
from typing import Any

import psutil
import pytest

from drcli.store import keys, lease
from drcli.store.last_outcome import read_outcome
from metadata_server import MetadataServer

pytestmark = pytest.mark.slow

LONG = 10_000
NEARLY_EXPIRED_S = lease.STALE_S - 4.0
COMMAND = ("start-training", "--resume-or-start", "--foreground", "--json")
"""What a boot script, cron or systemd would call."""


def journal(workspace: Any) -> list[dict[str, Any]]:
    events: list[dict[str, Any]] = json.loads(
        workspace.run("journal", "--json").stdout.splitlines()[-1]
    )["events"]
    return events


def processes_of(workspace: Any) -> list[psutil.Process]:
    """The workers and the supervisor of a workspace."""
    record = workspace.record()
    pids = [record["pid"], *(worker["pid"] for worker in record["workers"])]
    return [psutil.Process(pid) for pid in pids]


def test_a_vanished_machine_is_replaced_by_the_same_command_in_an_empty_folder(
    workspace, new_workspace
):
    workspace.hyperparameters["term_cond_max_episodes"] = LONG
    workspace.write_custom_files()
    first = workspace.start(*COMMAND)
    workspace.wait_for(lambda: workspace.iterations() >= 2, "two iterations")
    gone = processes_of(workspace)
    for process in gone:  # the machine vanishes: nothing is told to anybody
        process.kill()
    died_s = time.monotonic()
    workspace.end_of(first)
    before = workspace.iterations()
    outcome = read_outcome(workspace.bucket(), workspace.prefix)
    assert outcome.state == "running"

    other = new_workspace()
    shutil.rmtree(other.folder / "custom_files")
    other.put_bucket(workspace.model.parent)
    # That of another machine, whose processes nobody here can look for.
    bucket = other.bucket()
    held = lease.read_lease(bucket, other.prefix)
    assert held is not None
    lease.write_lease(bucket, other.prefix, replace(held, machine="another"))
    path = other.model.parent / keys.lease(other.prefix)
    os.utime(path, (time.time() - NEARLY_EXPIRED_S,) * 2)
    second = other.start(*COMMAND)
    other.wait_for(lambda: other.iterations() >= before, "the iterations of the first machine")
    other.wait_for(lambda: other.iterations() > before, "one iteration more")

    assert time.monotonic() - died_s < 120.0
    assert before >= 2
    stopped = other.run("stop-training")
    ended = other.end_of(second)
    assert stopped.returncode == 0
    assert ended.returncode == 143
    kinds = [event["kind"] for event in journal(other)]
    assert kinds.count("start") == 2
    assert "recovery" in kinds
    again = other.run(*COMMAND)
    assert again.returncode == 0
    assert "stays stopped: somebody stopped it" in again.stderr


@pytest.fixture
def metadata():
    with MetadataServer() as server:
        yield server


def test_a_notice_saves_everything_and_the_next_start_goes_on_to_the_end(workspace, metadata):
    workspace.hyperparameters["term_cond_max_episodes"] = LONG
    workspace.write_custom_files()
    workspace.environment["AWS_EC2_METADATA_SERVICE_ENDPOINT"] = metadata.address
    training = workspace.start(*COMMAND)
    workspace.wait_for(lambda: workspace.iterations() >= 2, "two iterations")
    began_s = time.monotonic()
    metadata.interrupt()
    ended = workspace.end_of(training)

    assert ended.returncode == 75
    assert time.monotonic() - began_s < 30.0
    bucket = workspace.bucket()
    outcome = read_outcome(bucket, workspace.prefix)
    assert (outcome.state, outcome.code, outcome.stays_ended) == ("interrupted", 75, False)
    assert lease.live_holder(bucket, workspace.prefix) is None
    learned = workspace.iterations()
    assert any("terminate this instance" in event["text"] for event in journal(workspace))

    metadata.answers.clear()
    workspace.hyperparameters["term_cond_max_episodes"] = learned + 1
    workspace.write_custom_files()
    resumed = workspace.run(*COMMAND)

    assert resumed.returncode == 0, resumed.stderr
    report = json.loads(resumed.stdout.splitlines()[-1])
    assert [one["iteration"] for one in report["history"]] == list(range(learned + 1))
    assert "optimizer starts over" not in workspace.log("trainer")
    finished = workspace.run(*COMMAND)
    assert finished.returncode == 0
    assert "Nothing to do for s3://bucket/model: Training is complete" in finished.stderr
    assert read_outcome(bucket, workspace.prefix).state == "finished"


def test_sigterm_of_a_scheduler_is_an_interruption_and_two_starts_are_one_training(
    workspace, new_workspace
):
    workspace.hyperparameters["term_cond_max_episodes"] = LONG
    workspace.write_custom_files()
    training = workspace.start(*COMMAND)
    workspace.wait_for(lambda: workspace.iterations() >= 1, "one iteration")
    second = workspace.run(*COMMAND, "--no-wait")
    waiting = workspace.start(*COMMAND)
    folder = workspace.folder / "data" / "runs" / "0"
    workspace.wait_for(lambda: list(folder.glob("waiting-*.json")), "the second start")
    training.send_signal(signal.SIGTERM)
    ended = workspace.end_of(training)
    workspace.wait_for(lambda: workspace.record().get("pid") == waiting.pid, "its turn")
    at = workspace.iterations()
    workspace.wait_for(lambda: workspace.iterations() > at, "one iteration more")
    os.kill(waiting.pid, signal.SIGINT)

    assert second.returncode == 9
    assert "is being trained by process" in second.stderr
    assert ended.returncode == 75
    assert workspace.end_of(waiting).returncode == 130

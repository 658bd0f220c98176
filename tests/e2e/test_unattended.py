"""Trainings whose machines come and go: one command starts, resumes, or does nothing."""

import json
import os
import shutil
import time
from dataclasses import replace
from typing import Any

import psutil
import pytest

from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome
from metadata_server import MetadataServer

pytestmark = pytest.mark.nightly

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


@pytest.fixture
def metadata():
    with MetadataServer() as server:
        yield server


def test_one_command_brings_a_run_to_its_end_on_machines_that_vanish_or_are_taken_away(
    workspace, new_workspace, metadata
):
    workspace.hyperparameters["term_cond_max_episodes"] = LONG
    workspace.write_custom_files()
    first = workspace.start(*COMMAND)
    workspace.wait_for(lambda: workspace.iterations() >= 1, "one iteration")
    refused = workspace.run(*COMMAND, "--no-wait")
    assert refused.returncode == 9, refused.stderr
    assert "is being trained by process" in refused.stderr

    for process in processes_of(workspace):  # the machine vanishes: nothing is told to anybody
        process.kill()
    workspace.end_of(first)
    before = workspace.iterations()
    assert read_outcome(ModelStore(workspace.bucket(), workspace.prefix)).state == "running"

    other = new_workspace()
    shutil.rmtree(other.folder / "custom_files")
    other.put_bucket(workspace.model.parent)
    bucket = other.bucket()
    held = lease.read_lease(ModelStore(bucket, other.prefix))
    assert held is not None
    # That of another machine, whose processes nobody here can look for.
    lease.write_lease(ModelStore(bucket, other.prefix), replace(held, machine="another"))
    path = other.model.parent / keys.lease(other.prefix)
    os.utime(path, (time.time() - NEARLY_EXPIRED_S,) * 2)
    other.environment["AWS_EC2_METADATA_SERVICE_ENDPOINT"] = metadata.address
    second = other.start(*COMMAND)
    other.wait_for(lambda: other.iterations() > before, "one iteration more")
    metadata.interrupt()
    ended = other.end_of(second)

    assert ended.returncode == 75, ended.stderr
    outcome = read_outcome(ModelStore(bucket, other.prefix))
    assert (outcome.state, outcome.code, outcome.stays_ended) == ("interrupted", 75, False)
    assert lease.live_holder(ModelStore(bucket, other.prefix)) is None
    learned = other.iterations()
    events = journal(other)
    assert [event["kind"] for event in events].count("start") == 2
    assert any("ended without recording why" in event["text"] for event in events)
    assert any("terminate this instance" in event["text"] for event in events)

    metadata.answers.clear()
    other.hyperparameters["term_cond_max_episodes"] = learned + 1
    other.write_custom_files()
    resumed = other.run(*COMMAND)

    assert resumed.returncode == 0, resumed.stderr
    report = json.loads(resumed.stdout.splitlines()[-1])
    assert [one["iteration"] for one in report["history"]] == list(range(learned + 1))
    finished = other.run(*COMMAND)
    assert finished.returncode == 0
    assert "Nothing to do for s3://bucket/model: Training is complete" in finished.stderr
    assert read_outcome(ModelStore(bucket, other.prefix)).state == "finished"

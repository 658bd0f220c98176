"""Trainings that are killed, stopped, damaged or out of space, with real worker processes."""

import json
import os
import shutil
import signal
import subprocess
from dataclasses import dataclass
from typing import Any

import psutil
import pytest

from drcli.model import lease
from drcli.model.model_store import ModelStore


def test_killed_processes_are_replaced_and_the_training_ends_as_if_nothing_had_happened(workspace):
    workspace.hyperparameters["term_cond_max_episodes"] = 10
    workspace.write_custom_files()
    training = workspace.start("start-training", "--json")

    for victim, iterations in (("sim-0", 1), ("trainer", 3), ("server", 5)):
        workspace.wait_for(lambda least=iterations: workspace.iterations() >= least, victim)
        pid = workspace.server_pid() if victim == "server" else workspace.pid_of(victim)
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
    ended = workspace.end_of(training, patience_s=120)

    assert ended.returncode == 0, ended.stderr + workspace.logs()
    report = json.loads(ended.stdout.splitlines()[-1])
    assert [r["iteration"] for r in report["history"]] == list(range(10))
    assert [worker["restarts"] for worker in report["workers"]] == [1, 1]
    _assert_every_object_is_readable(workspace)


def _assert_every_object_is_readable(workspace) -> None:
    from drcli.model.checkpoints import CheckpointStore

    bucket = workspace.bucket()
    names = [info.key for info in bucket.list("")]
    for key in names:
        data = bucket.get(key)
        if key.endswith(".json"):
            json.loads(data)
    assert (
        CheckpointStore(ModelStore(bucket, workspace.prefix))
        .load_latest(with_optimizer=True)
        .damaged
        == ()
    )
    assert not [key for key in names if key.startswith("rollouts/")]


@dataclass(frozen=True)
class Interrupted:
    """A training that was looked at while it ran, and then ended by SIGTERM.

    Attributes:
        workspace: Its folder.
        gpus: What its workers were told about GPUs, by name of the worker.
        second: What another run that wanted the same prefix answered meanwhile.
        code: Exit code of the interrupted command.
    """

    workspace: Any
    gpus: dict[str, str]
    second: "subprocess.CompletedProcess[str]"
    code: int


@pytest.fixture(scope="module")
def interrupted(shared_workspace):
    """One training for all that looks at a training that runs on and on."""
    space = shared_workspace
    space.hyperparameters["term_cond_max_episodes"] = 10_000
    space.write_custom_files()
    with (space.folder / "system.env").open("a") as file:
        file.write("DR_SAGEMAKER_CUDA_DEVICES=-1\n")
    space.environment["CUDA_VISIBLE_DEVICES"] = "0"
    training = space.start("start-training", "--foreground")
    space.wait_for(lambda: space.iterations() >= 2, "two iterations")
    gpus = {
        name: psutil.Process(space.pid_of(name)).environ()["CUDA_VISIBLE_DEVICES"]
        for name in ("trainer", "sim-0")
    }
    space.write_run_env(DR_RUN_ID=1)
    second = space.run("start-training", "-w")
    space.write_run_env()
    training.send_signal(signal.SIGTERM)
    return Interrupted(space, gpus, second, space.end_of(training).returncode)


@pytest.mark.nightly
def test_the_trainer_alone_is_told_which_gpus_are_its_own(interrupted):
    assert interrupted.gpus == {"trainer": "-1", "sim-0": "0"}


@pytest.mark.nightly
def test_two_trainings_cannot_share_a_prefix(interrupted):
    assert interrupted.second.returncode == 3
    assert "is being trained" in interrupted.second.stderr


@pytest.mark.nightly
def test_sigterm_saves_everything_another_machine_continues_and_loses_to_a_third(
    interrupted, new_workspace
):
    workspace = interrupted.workspace

    assert interrupted.code == 143
    model = workspace.model
    assert {p.name for p in (model / "logs").rglob("*.log")} >= {"sim-0.log", "trainer.log"}
    before = workspace.status()
    assert before["state"] == "stopped"
    elsewhere = new_workspace()
    shutil.rmtree(elsewhere.folder / "custom_files")
    elsewhere.put_bucket(model.parent)
    second = elsewhere.start("start-training", "--resume", "--foreground")
    wanted = len(before["history"]) + 1
    elsewhere.wait_for(lambda: elsewhere.iterations() >= wanted, "one iteration more")
    bucket = elsewhere.bucket()
    theirs = lease.take(ModelStore(bucket, elsewhere.prefix), "a third start")
    lost = elsewhere.end_of(second, patience_s=30)

    assert lost.returncode == 8
    assert f"is trained by process {theirs.pid}" in " ".join(lost.stderr.split())
    assert lease.holder(ModelStore(bucket, elsewhere.prefix)).session == "a third start"
    after = elsewhere.status()
    assert after["history"][: len(before["history"])] == before["history"]
    assert after["history"][-1]["total_steps"] > before["history"][-1]["total_steps"]
    assert "optimizer starts over" not in elsewhere.log("trainer")


@pytest.mark.nightly
def test_a_truncated_checkpoint_is_passed_over_and_said(workspace, trained, log_guru):
    workspace.put(trained)
    model = workspace.model / "model"
    newest = (model / ".coach_checkpoint").read_text()
    weights = model / f"{newest}.safetensors"
    weights.write_bytes(weights.read_bytes()[:1000])
    workspace.hyperparameters["term_cond_max_episodes"] = 4
    workspace.write_custom_files()

    resumed = workspace.run("start-training", "--resume", "--json")

    assert resumed.returncode == 0, resumed.stderr
    assert f"Skipped a damaged checkpoint: {newest}" in workspace.log("trainer")
    assert len(json.loads(resumed.stdout.splitlines()[-1])["history"]) == 4
    # The third iteration was driven twice, and log-guru stops at an episode that comes again.
    assert len(log_guru(workspace.log("sim-0")).episodes) == 16


@pytest.mark.nightly
def test_a_full_disk_ends_the_run_at_once_and_names_it(workspace):
    mount = workspace.folder / "data" / "s3"
    mount.mkdir(parents=True)
    size = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(mount)]
    if shutil.which("mount") is None or subprocess.run(size, capture_output=True).returncode != 0:
        pytest.skip("only root can make a small disk")
    try:
        ended = workspace.run("start-training")

        assert ended.returncode == 4
        said = " ".join(ended.stderr.split())  # by whoever sees it first
        assert f"the disk under {mount} is full" in said or f"left on the disk of {mount}" in said
        assert workspace.record()["workers"][0]["restarts"] == 0
    finally:
        workspace.clean_up()
        subprocess.run(["umount", "--lazy", str(mount)], check=True)

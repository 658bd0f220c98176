"""Trainings whose workers Ray places, with a real cluster on this machine."""

import json
import os
import signal

import psutil
import pytest

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(600)]

PATIENCE_S = 240.0
"""For processes of Ray, each of which takes seconds to start."""

pytest.importorskip("ray", reason="the extra ray is not installed")


@pytest.fixture
def by_ray(workspace):
    (workspace.folder / "system.env").write_text(
        "DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\nDR_LAUNCHER=ray\n"
    )
    workspace.environment["RAY_AUTH_MODE"] = "disabled"
    return workspace


def test_ray_replaces_a_worker_that_was_killed_and_leaves_nothing_behind(by_ray):
    by_ray.hyperparameters["term_cond_max_episodes"] = 20
    by_ray.write_custom_files()
    training = by_ray.start("start-training", "--json", "--foreground")
    by_ray.wait_for(lambda: by_ray.iterations() >= 2, "the first iterations", PATIENCE_S)
    supervisor = psutil.Process(training.pid)
    hosts = [each for each in supervisor.children(recursive=True) if _drives(each)]
    os.kill(hosts[0].ppid(), signal.SIGKILL)  # the actor: its worker ends with it

    ended = by_ray.end_of(training)

    assert ended.returncode == 0, ended.stderr
    report = json.loads(ended.stdout.splitlines()[-1])
    assert [record["iteration"] for record in report["history"]] == list(range(20))
    words = by_ray.log("ray")
    assert words.count("drives on") == 2
    assert "It is placed again." in words
    assert not [each for each in psutil.process_iter(["cmdline"]) if _is_of(each, by_ray)]


@pytest.fixture
def cluster(monkeypatch):
    """Two simulated nodes with a core and a GPU each, which is only a number for Ray."""
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        for _ in range(2):
            cluster.add_node(num_cpus=1, num_gpus=1)
        yield cluster
    finally:
        cluster.shutdown()


def test_a_trainer_whose_node_is_gone_goes_on_on_another_one_and_nothing_is_lost(by_ray, cluster):
    by_ray.hyperparameters["term_cond_max_episodes"] = 10_000
    by_ray.write_custom_files()
    with (by_ray.folder / "system.env").open("a") as file:
        file.write(f"DR_RAY_ADDRESS={cluster.address}\nDR_RAY_TRAINER=gpu\n")
    training = by_ray.start("start-training", "--json", "--foreground")
    by_ray.wait_for(lambda: by_ray.iterations() >= 2, "the first iterations", PATIENCE_S)
    trainer = _trainer_on_a_node()
    assert trainer.environ()["CUDA_VISIBLE_DEVICES"] != ""

    cluster.remove_node(_node_of(trainer, cluster), allow_graceful=False)
    done = by_ray.iterations()
    by_ray.wait_for(
        lambda: by_ray.iterations() >= done + 3, "iterations of another trainer", PATIENCE_S
    )
    by_ray.wait_for(lambda: _shown(by_ray)["health"]["progress_age_s"] is not None, "its heartbeat")
    shown = _shown(by_ray)
    by_ray.run("stop-training")
    ended = by_ray.end_of(training)

    assert ended.returncode == 143, ended.stderr
    assert shown["alive"]
    assert shown["restarts"] >= 1
    report = json.loads(ended.stdout.splitlines()[-1])
    numbers = [record["iteration"] for record in report["history"]]
    assert numbers == list(range(len(numbers)))
    words = by_ray.run("logs", "trainer", "--all").stdout
    assert words.count("The trainer runs on") == 2
    assert all(f"Metrics> iteration={number} " in words for number in (numbers[0], numbers[-1]))
    assert _trainer_on_a_node() is None


def _shown(workspace) -> dict:
    """The trainer in the status."""
    [shown] = [worker for worker in workspace.status()["workers"] if worker["name"] == "trainer"]
    return shown


def _trainer_on_a_node() -> "psutil.Process | None":
    """The trainer of an actor of Ray; None if there is none."""
    for process in psutil.process_iter(["cmdline"]):
        if "drcli.train.trainer" in (process.info["cmdline"] or []):
            parent = process.parent()
            if parent is not None and "ray::" in " ".join(parent.cmdline()):
                return process
    return None


def _node_of(process: "psutil.Process", cluster):
    """The node of a cluster on which an actor's process runs."""
    pids = {each.pid for each in process.parents()}
    for node in cluster.worker_nodes:
        if any(each.process.pid in pids for each in node.all_processes["raylet"]):
            return node
    raise AssertionError("no node of the cluster")


def _drives(process: "psutil.Process") -> bool:
    """Whether a process is the `dr-start-worker` of an actor."""
    try:
        return "--end-with-parent" in process.cmdline()
    except psutil.Error:
        return False


def _is_of(process: "psutil.Process", workspace) -> bool:
    """Whether a process of Ray or of a worker has been left of a workspace."""
    words = " ".join(process.info["cmdline"] or [])
    return "--end-with-parent" in words and workspace.prefix in words

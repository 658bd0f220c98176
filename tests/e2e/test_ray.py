"""A training whose simulation workers Ray places, with a real cluster on this machine."""

import json
import os
import signal

import psutil
import pytest

pytestmark = pytest.mark.slow

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
    by_ray.wait_for(lambda: by_ray.iterations() >= 2, "the first iterations")
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

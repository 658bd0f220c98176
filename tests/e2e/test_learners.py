"""A training with two learner processes goes on when one of them is killed."""

import json
import os
import signal

import psutil
import pytest

pytestmark = pytest.mark.nightly


def test_a_training_survives_the_end_of_a_learner_process(workspace):
    system = workspace.folder / "system.env"
    system.write_text("DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\nDR_TRAIN_LEARNERS=2\n")
    workspace.hyperparameters["term_cond_max_episodes"] = 16
    workspace.write_custom_files()
    training = workspace.start("start-training", "--json", "--foreground")
    workspace.wait_for(lambda: workspace.iterations() >= 2, "the first iterations")
    supervisor = psutil.Process(training.pid)
    learners = [each for each in supervisor.children(recursive=True) if _learns(each)]
    os.kill(learners[0].pid, signal.SIGKILL)

    ended = workspace.end_of(training)

    assert ended.returncode == 0, ended.stderr
    report = json.loads(ended.stdout.splitlines()[-1])
    iterations = [record["iteration"] for record in report["history"]]
    assert iterations == list(range(len(iterations)))
    assert sum(record["episodes"] for record in report["history"]) >= 16
    assert len(learners) == 1
    assert "A learner process of DR_TRAIN_LEARNERS has ended" in workspace.log("trainer")
    psutil.wait_procs(learners, timeout=10)
    assert not any(each.is_running() for each in learners)


def _learns(process: "psutil.Process") -> bool:
    """Whether a process is one of the other learner processes."""
    try:
        return "drcli.train.learner_process" in process.cmdline()
    except psutil.Error:
        return False

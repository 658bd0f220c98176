"""A training with a teacher, through the real commands: killed in each of its phases."""

import json
import os
import signal

import pytest

from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore

pytestmark = pytest.mark.nightly

REWARD = "    return 1.0 if params['all_wheels_on_track'] else 1e-3\n"


def test_a_student_drives_after_its_teacher_though_the_trainer_is_killed_in_both_phases(workspace):
    workspace.hyperparameters |= {"training_method": "teacher", "term_cond_max_episodes": 18}
    workspace.write_custom_files(REWARD)
    store = CheckpointStore(ModelStore(workspace.bucket(), workspace.prefix))

    def phase() -> str:
        newest = store.pointed()
        mark = None if newest is None else store.record(str(newest)).counters.phase
        return "" if mark is None else mark.name

    training = workspace.start("start-training", "--until-lap-time", "14", "--json")
    for name in ("teacher", "distillation"):
        workspace.wait_for(lambda: workspace.iterations() >= 2, "two iterations")
        workspace.wait_for(lambda wanted=name: phase() == wanted, f"the phase {name}", 120)
        os.kill(workspace.pid_of("trainer"), signal.SIGKILL)
    ended = workspace.end_of(training, patience_s=120)
    evaluated = workspace.run("evaluate", "--json")
    exported = workspace.run("export", "pb", "--json")

    assert ended.returncode == 0, ended.stderr + workspace.logs()
    history = json.loads((workspace.model / "metrics" / "history.json").read_text())["iterations"]
    assert [r["iteration"] for r in history] == list(range(18))
    phases = [r["phase"] for r in history]
    assert phases == sorted(phases, key=["teacher", "distillation", "ppo"].index)
    assert {"teacher", "distillation"} <= set(phases)
    assert not any(r["evaluation_progress"] for r in history if r["phase"] == "teacher")
    assert evaluated.returncode == 0, evaluated.stderr
    progress = [p for r in history for p in r["evaluation_progress"]]
    assert max(progress) == 100.0, progress
    assert exported.returncode == 0, exported.stderr

"""A training in stages with real workers, killed just when its second stage is to begin."""

import json
import os
import signal
from contextlib import suppress

import pytest

pytestmark = pytest.mark.nightly

TWO = """\
stages:
  - name: wide
    world: bean
    goal: {iterations: 1}
  - name: bots
    world: paddle
    race_type: HEAD_TO_BOT
    reward_function: bots.py
    hyperparameters: {num_episodes_between_training: 2, lr: 0.0002}
    settings: {DR_H2B_NUMBER_OF_BOT_CARS: 1}
    goal: {steps: 1}
"""


def test_a_training_goes_through_its_stages_even_if_it_is_killed_between_them(workspace):
    # 001-25, 001-47, 003-10, 003-11
    workspace.write_run_env(
        DR_CURRICULUM_FILE="curriculum.yaml",
        DR_TRAIN_EVAL_WORLD="bean",
        DR_TRAIN_EVAL_SHARE=1,
    )
    (workspace.folder / "curriculum.yaml").write_text(TWO)
    (workspace.folder / "bots.py").write_text("def reward_function(params):\n    return 3.0\n")
    note = workspace.folder / "data" / "runs" / "0" / "stage.json"

    first = workspace.start("start-training", "--foreground")
    workspace.wait_for(note.exists, "the second stage")
    for name in ("sim-0", "trainer"):
        with suppress(ProcessLookupError):
            os.kill(workspace.pid_of(name), signal.SIGKILL)
    first.kill()
    first.communicate()
    ended = workspace.end_of(workspace.start("start-training", "--resume-or-start", "--json"), 120)

    assert ended.returncode == 0, ended.stderr + workspace.logs()
    report = json.loads(ended.stdout.splitlines()[-1])
    assert report["message"] == (
        "Training is complete: its last stage, bots, is over: "
        f"{report['history'][1]['steps']} steps are done."
    )
    assert [(r["stage"], r["episodes"]) for r in report["history"]] == [("wide", 4), ("bots", 2)]
    driven = report["history"][1]
    assert driven["mean_reward"] == pytest.approx(3.0 * driven["steps"] / 2)
    assert (report["world"], report["stage"]["name"]) == ("paddle", "bots")
    assert {r["second_world"] for r in report["history"]} == {"bean"}
    metrics = json.loads(workspace.bucket().get("model/metrics/TrainingMetrics.json"))["metrics"]
    assert [m["stage"] for m in metrics if m["phase"] == "training"] == ["wide"] * 4 + ["bots"] * 2

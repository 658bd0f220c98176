"""The reference's own run.env and system.env train and evaluate a model, and act as they should."""

import json
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

REFERENCE = Path(__file__).resolve().parents[1] / "data" / "reference"


def test_the_files_of_the_reference_train_and_evaluate(workspace):
    for name in ("run.env", "system.env"):
        (workspace.folder / name).write_bytes((REFERENCE / name).read_bytes())
    workspace.hyperparameters |= {"num_episodes_between_training": 2, "term_cond_max_episodes": 1}
    workspace.write_custom_files()

    checked = workspace.run("config", "check")
    trained = workspace.run("start-training")
    workspace.environment["DR_EVAL_NUMBER_OF_TRIALS"] = "1"  # three last long
    evaluated = workspace.run("evaluate", "--json")

    assert checked.returncode == 0
    assert "Settings: 0 errors, 0 warnings.\n" in checked.stdout
    assert "A training can start." in checked.stdout
    assert trained.returncode == 0, trained.stderr
    assert "of the settings are for containers" not in checked.stdout + trained.stderr
    assert "Accepted without effect:" in checked.stdout
    assert "DR_SIMAPP_VERSION" not in trained.stderr
    assert evaluated.returncode == 0, evaluated.stderr
    report = json.loads(evaluated.stdout.splitlines()[-1])
    assert report["prefix"] == "rl-deepracer-sagemaker"
    assert report["world"] == "reinvent_base"
    assert report["trials"]

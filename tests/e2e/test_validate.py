"""`dr-validate` as a user runs it, on a real bucket and with a real reward function."""

import json

import pytest

pytestmark = pytest.mark.nightly


def test_a_folder_is_judged_in_text_and_in_json_before_anything_was_started(workspace):
    good = workspace.run("validate", "--json")
    workspace.write_run_env(DR_WORLD_NAME="reinvent_bse")
    workspace.hyperparameters = {"lr": 1.5}
    workspace.write_custom_files(reward="    return params['sped']\n")

    bad = workspace.run("validate")
    forced = workspace.run("validate", "--json", "--force")

    assert (good.returncode, bad.returncode, forced.returncode) == (0, 3, 0), bad.stderr
    assert json.loads(good.stdout)["errors"] == []
    report = json.loads(forced.stdout.splitlines()[-1])
    assert [(item["rule"], item["where"]) for item in report["errors"]] == [
        ("V-05", "run.env line 1"),
        ("V-21", "custom_files/reward_function.py line 2"),
        ("V-41", "custom_files/hyperparameters.json line 1"),
    ]
    for error in report["errors"]:
        assert error["rule"] in bad.stdout
        assert error["where"] in bad.stdout
    assert workspace.record() == {}

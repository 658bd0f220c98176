"""`dr reward` as its own program: a drive, a racer's file, text, JSON and pictures."""

import json

import pytest
from PIL import Image

pytestmark = pytest.mark.nightly

NEAR = "def reward_function(params):\n    return 1 - params['distance_from_center']\n"

LOGS = """HISTORY = []
def reward_function(params):
    HISTORY.append(params["speed"])
    with open("rewards.log", "a") as log:
        print(params["steps"], file=log)
    return params["speed"]
"""


@pytest.fixture
def swift(workspace):
    """Whose model can drive slowly and fast."""
    path = workspace.folder / "custom_files" / "model_metadata.json"
    actions = {"speed": {"low": 1.0, "high": 3.0}, "steering_angle": {"low": -30, "high": 30}}
    metadata = json.loads(path.read_text())
    kind = {"action_space_type": "continuous", "action_space": actions}
    path.write_text(json.dumps(metadata | kind))
    return workspace


def test_a_sound_function_is_checked_drawn_and_compared(swift):
    workspace = swift
    (workspace.folder / "custom_files" / "reward_function.py").write_text(
        "def reward_function(params):\n"
        "    return float(params['speed'] ** 2 * params['all_wheels_on_track'])\n"
    )
    other = workspace.folder / "other.py"
    other.write_text(
        "def reward_function(params):\n    return 1 - params['distance_from_center']\n"
    )

    checked = workspace.run("reward", "check", "--json")
    drawn = workspace.run("reward", "plot", "--world", "bean")
    compared = workspace.run(
        "reward", "compare", "custom_files/reward_function.py", "other.py", "-o", "both.png"
    )

    assert [run.returncode for run in (checked, drawn, compared)] == [0, 0, 0]
    told = json.loads(checked.stdout.splitlines()[-1])
    assert told["file"] == "custom_files/reward_function.py"
    assert told["works"] is True
    assert all(parameter["greatest"] is not None for parameter in told["parameters"][:4])
    assert drawn.stdout.startswith("Picture: reward.png")
    assert "B pays more for a slow lap." in compared.stdout
    for name in ("reward.png", "both.png"):
        with Image.open(workspace.folder / name) as picture:
            assert picture.width >= 1400


def test_what_keeps_no_training_from_its_start_is_a_warning_with_its_line(swift):
    workspace = swift
    (workspace.folder / "custom_files" / "reward_function.py").write_text(LOGS)

    checked = workspace.run("reward", "check")

    assert checked.returncode == 0
    assert "Warning: custom_files/reward_function.py line 4 (V-25)" in checked.stdout
    assert "rewards.log" in checked.stdout
    assert "(cancels-out)" in checked.stdout

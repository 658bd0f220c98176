"""What commands must not load: each of these libraries takes longer than people wait."""

import os
import subprocess
import sys

import pytest

from drcli.cli.completion import ASKS, LINE

SIMULATION = {"torch", "mujoco", "numba", "numpy", "gymnasium", "drsim", "scipy", "shapely"}
STORAGE = {"boto3", "botocore", "moto"}
VALUES = {"pydantic"}
PROGRAM = "import sys; from drcli.cli.app import main\ntry: main(sys.argv[1:])\nfinally: "


def loaded(*arguments: str) -> set[str]:
    """Libraries that a command has loaded when it ends."""
    slow = SIMULATION | STORAGE | VALUES
    done = subprocess.run(
        [sys.executable, "-c", f"{PROGRAM}print(*({slow!r} & sys.modules.keys()))", *arguments],
        env={name: value for name, value in os.environ.items() if not name.startswith("DR_")},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    assert "Traceback" not in done.stderr
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    "line",
    ["config show", "update", "url", "init x"],
)
def test_a_command_that_only_looks_loads_neither_simulation_nor_storage(working_folder, line):
    assert not loaded(*line.split()) & (SIMULATION | STORAGE)


def test_only_the_sandbox_of_a_reward_function_loads_the_simulation(working_folder):
    assert not loaded(*["reward", "check"]) & ((SIMULATION | STORAGE) - {"numpy"})


def test_looking_at_a_training_asks_no_server(working_folder):
    record = working_folder / "data" / "runs" / "0" / "run.json"
    record.parent.mkdir(parents=True)
    record.write_text(
        '{"run_id": 0, "session": "s", "bucket": "bucket", "prefix": "model", "world": "w", '
        '"state": "finished", "pid": 1, "pid_started": 1.0, "started_at": 1.0, "workers": []}'
    )
    (working_folder / "data" / "s3" / "bucket").mkdir(parents=True)

    assert not loaded("status") & (SIMULATION | STORAGE)


@pytest.mark.parametrize(
    "line",
    [
        "status",
        "summary",
        "config check --settings",
        "config set DR_RUN_ID=0",
        "stop-training",
        "logs",
        "completion show bash",
    ],
)
def test_a_common_command_loads_nothing_slow_at_all(working_folder, line):
    assert not loaded(*line.split())


def test_listing_models_loads_no_pydantic(working_folder):
    assert not loaded("list-models", "--upload") & VALUES


def test_the_tab_key_loads_no_pydantic(working_folder, monkeypatch):
    for name, value in {**ASKS, LINE: "dr config set DR_WORK"}.items():
        monkeypatch.setenv(name, value)

    assert not loaded()


@pytest.mark.parametrize(
    "line", ["--version", "status --help", "config --help", "config set --help", "shell-env"]
)
def test_what_needs_no_settings_loads_nothing_that_is_slow(working_folder, line):
    assert not loaded(*line.split())

"""Several commands, runs and users of one machine, none of which gets in another's way."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from drcli.config.loading import load_settings
from drcli.config.new_folder import plan_experiment, write

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).resolve().parents[2]


def test_of_two_starts_one_trains_and_an_experiment_trains_beside_it(workspace):
    workspace.hyperparameters["term_cond_max_episodes"] = 1
    workspace.write_custom_files()
    write(plan_experiment(workspace.folder, "beside", {}))
    workspace.environment["DR_TRAIN_MIN_EVAL_TRIALS"] = "1"

    twins = [workspace.start("start-training", "-q") for _ in range(2)]
    workspace.environment["DR_EXPERIMENT_NAME"] = "beside"
    beside = workspace.run("start-training")
    ended = [process.communicate(timeout=90) for process in twins]
    other = workspace.status()
    del workspace.environment["DR_EXPERIMENT_NAME"]
    workspace.wait_for(lambda: workspace.record()["state"] != "running", "the first training")

    refusal = next(err for _, err in ended if "Error: " in err)
    assert sorted(process.returncode for process in twins) == [0, 3]
    assert "Try: " in refusal
    assert beside.returncode == 0, beside.stderr
    assert (other["run_id"], other["prefix"], other["state"]) == (1, "beside", "finished")
    mine = workspace.status()
    assert (mine["run_id"], mine["prefix"], mine["state"]) == (0, "model", "finished")
    assert len(mine["history"]) == len(other["history"]) == 1


def test_of_many_edits_at_once_none_is_lost(workspace):
    wanted = {"DR_WORKERS": "2", "DR_RUN_ID": "5", "DR_CAR_NAME": "Quick", "DR_RACER_NAME": "Me"}

    edits = [workspace.start("config", "set", f"{name}={value}") for name, value in wanted.items()]
    ended = [process.communicate(timeout=90) for process in edits]

    settings = load_settings(workspace.folder, environ={})
    assert [process.returncode for process in edits] == [0] * len(edits), ended
    assert (settings.workers, settings.run_id, settings.car_name) == (2, 5, "Quick")
    assert settings.racer_name == "Me"


@pytest.fixture
def installation(tmp_path: Path) -> Path:
    """A copy of the programs that nobody may write to."""
    copy = tmp_path / "read only"
    leave_out = shutil.ignore_patterns("__pycache__")
    for package in ("drcli", "env/drsim", "defaults"):
        shutil.copytree(ROOT / package, copy / package, ignore=leave_out)
    for name in ("run.env", "system.env"):
        shutil.copy(ROOT / name, copy / name)
    for path in (copy, *copy.rglob("*")):
        path.chmod(path.stat().st_mode & ~0o222)
    return copy


def test_a_read_only_installation_serves_a_folder_elsewhere_and_leaves_files_to_their_user(
    installation, tmp_path
):
    folder = tmp_path / "Müllers Auto"
    before = {path: path.stat().st_mtime_ns for path in installation.rglob("*")}
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DR_")}
    path = f"{installation}{os.pathsep}{installation / 'env'}"
    environment = {**kept, "DR_DIR": str(folder), "PYTHONPATH": path}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # root may write where nobody may
    commands = [
        ["init", str(folder), "--prefix", "mine"],
        ["config", "set", "DR_WORLD_NAME=bean"],
        ["upload-custom-files"],
        ["list-models"],
        ["status"],
    ]
    stop = "from drcli.config.loading import *; from drcli.bucket.server import server; "
    stop += "from pathlib import *; "
    stop += f"f = Path({str(folder)!r}); server.stop(load_settings(f).storage)"

    old = os.umask(0o027)
    try:
        for command in commands:
            program = f"from drcli.cli.app import main; main({command!r})"
            done = subprocess.run(
                [sys.executable, "-c", program],
                cwd=installation,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=90,
            )
            assert done.returncode == 0, f"{command}: {done.stderr}"
    finally:
        os.umask(old)
        subprocess.run([sys.executable, "-c", stop], env=environment, check=True, timeout=60)

    assert {path: path.stat().st_mtime_ns for path in installation.rglob("*")} == before
    files = [path.lstat() for path in (folder, *folder.rglob("*"))]
    assert len(files) > 10
    assert {facts.st_uid for facts in files} == {os.getuid()}
    assert not [facts for facts in files if stat.S_IMODE(facts.st_mode) & 0o007]

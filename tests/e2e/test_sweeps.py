"""A sweep with real trainings: one is broken, one ends early, one is best."""

import json
import signal

import psutil
import pytest

pytestmark = pytest.mark.nightly

PATIENCE_S = 300.0
"""Ray starts six processes, and each training one more."""

SWEEP = """
name: pace
vary:
  reward_function: [custom_files/reward_function.py, broken.py]
  seed: [1, 2]
budget: {iterations: 20}
early_stopping: {method: halving, first_check: 0.05, reduction_factor: 2}
"""


def test_a_sweep_is_interrupted_continues_and_marks_the_best(workspace):
    _interrupt_and_continue(workspace)


@pytest.mark.timeout(2 * PATIENCE_S + 100.0)
def test_ray_places_the_same_sweep(workspace):
    pytest.importorskip("ray", reason="the extra ray is not installed", exc_type=ImportError)
    (workspace.folder / "system.env").write_text(
        "DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\nDR_LAUNCHER=ray\n"
    )
    workspace.environment["RAY_AUTH_MODE"] = "disabled"

    _interrupt_and_continue(workspace, SWEEP + "parallel: 2\n")

    left = [each for each in psutil.process_iter(["cmdline"]) if _is_of(each, workspace)]
    assert not left


def _is_of(process, workspace):
    """Whether a process trains something of a workspace."""
    words = process.info["cmdline"] or []
    try:
        trains = (
            "drcli.base.start_module" in words and "drcli.bucket.server.moto_server" not in words
        )
        return trains and process.cwd() == str(workspace.folder)
    except psutil.Error:
        return False


def _interrupt_and_continue(workspace, sweep=SWEEP):
    (workspace.folder / "broken.py").write_text(
        "def reward_function(params):\n    return nothing\n"
    )
    (workspace.folder / "sweep.yaml").write_text(sweep)

    first = workspace.start("sweep", "sweep.yaml")
    record = workspace.folder / "data" / "s3" / "bucket" / "sweeps" / "pace.json"
    workspace.wait_for(
        lambda: record.exists() and '"running"' in record.read_text(), "the first training"
    )
    first.send_signal(signal.SIGTERM)
    ended = workspace.end_of(first, PATIENCE_S)

    assert ended.returncode == 143, ended.stderr
    assert "Continue it with the same command." in ended.stderr

    ended = workspace.end_of(workspace.start("sweep", "sweep.yaml", "--json"), PATIENCE_S)

    assert ended.returncode == 0, ended.stderr
    report = json.loads(ended.stdout.splitlines()[-1])
    states = {trial["name"]: trial["state"] for trial in report["trials"]}
    # The level of the first check is one iteration, and 20 take longer than an interruption.
    assert sorted(states.values()) == ["failed", "failed", "finished", "stopped early"]
    assert (states["pace-03"], states["pace-04"]) == ("failed", "failed")
    assert report["best"] in ("pace-01", "pace-02")
    assert "is not defined" in next(
        t["message"] for t in report["trials"] if t["name"] == "pace-03"
    )
    shown = workspace.run("sweep", "show", "pace")
    assert f"* best; its model is {report['best']}" in " ".join(shown.stdout.split())
    models = workspace.run("list-models")
    assert "Best of sweep pace" in models.stdout
    workspace.environment["DR_EXPERIMENT_NAME"] = "pace-01"
    assert workspace.status()["prefix"] == "pace-01"
